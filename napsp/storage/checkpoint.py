"""Trained models on disk: safetensors with a JSON header, written atomically, never unpickled."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from napsp.config import TrainConfig, from_dict, to_dict
from napsp.distance.counts import KeyCounts, SimHash, VisitCounts
from napsp.distance.network import DistanceNetwork
from napsp.envs import canonical_name
from napsp.envs.goal_task import own_box
from napsp.errors import UserError, close
from napsp.policy.actors import DeterministicPolicy, GaussianPolicy, Policy
from napsp.storage.files import FORMAT, OLDER, read_tensors, sound, write_tensors
from napsp.storage.older import todays
from napsp.storage.revision import git_revision
from napsp.storage.shipped import MODEL_FILE, SHIPPED, shipped_names


@dataclass(frozen=True)
class Model:
    """A trained distance and policy.

    Attributes:
        distance: d(s, a, g); None for a checkpoint of the sparse baseline.
        policy: pi(a | s, g).
        config: the configuration it was trained with.
        header: revision, seed, episodes and sizes.
        visits: N(s, a) at the end of training; None in files that were written without it.
    """

    distance: DistanceNetwork | None
    policy: Policy
    config: TrainConfig
    header: dict[str, Any]
    visits: VisitCounts | None = None

    def check_sizes(self, env: Any) -> None:
        """Check that the model reads what ``env`` offers; a task of one's own may have changed since.

        Raises:
            UserError: observation, action or goal have other widths, or actions other bounds.
        """
        trained, found = tuple(self.header["sizes"]), sizes_of(env)
        if trained != found:
            raise UserError(
                f"this checkpoint was trained with {trained} numbers of observation, action and goal, and "
                f"{self.config.env} has {found} now; train it again"
            )
        box, now = self.header.get("action_box"), own_box(env)
        if box and not (isinstance(box, list) and len(box) == 2):
            raise UserError("this checkpoint does not say between which bounds its actions lie; train it again")
        if box and now and box != now:
            raise UserError(
                f"this checkpoint was trained with actions from {box[0]} to {box[1]}, and {self.config.env} takes "
                f"{now[0]} to {now[1]} now; train it again"
            )


def sizes_of(env: Any) -> tuple[int, int, int]:
    """Widths of observation, action and goal."""
    spaces = env.observation_space.spaces
    return spaces["observation"].shape[0], env.action_space.shape[0], spaces["desired_goal"].shape[0]


def save_model(
    path: Path,
    policy: Policy,
    distance: DistanceNetwork | None,
    config: TrainConfig,
    sizes: tuple[int, int, int],
    episodes: int,
    visits: VisitCounts | None = None,
    action_box: list[list[float]] | None = None,
) -> None:
    """Write what a planner or a robot needs: weights, scaling, configuration, and N(s, a) if given."""
    tensors = {f"policy.{name}": value for name, value in policy.state_dict().items()}
    if distance is not None:
        tensors |= {f"distance.{name}": value for name, value in distance.state_dict().items()}
    if visits is not None:
        parts = (visits.hash.projection, visits.table.keys, visits.table.counts)
        tensors |= {f"visits.{name}": torch.from_numpy(_narrow(p)) for name, p in zip(COUNT_TABLE, parts, strict=True)}
    header = {
        "format": FORMAT,
        "kind": "model",
        "config": to_dict(config),
        "episode_length": config.episode_length,
        "sizes": list(sizes),
        "action_box": action_box,
        "episodes": episodes,
        "revision": git_revision(),
    }
    write_tensors(path, tensors, header)


def load_model(path: str | Path, env: str | None = None) -> Model:
    """Read a model; ``path`` is the file, its folder, or the name of one that ships, ``env`` the task it has to be of.

    Raises:
        UserError: damaged or foreign file, or a model of another environment.
    """
    path = Path(path)
    if not path.exists() and path == Path(path.name):
        if path.name in shipped_names():
            path = SHIPPED / path.name
        elif meant := close(path.name, shipped_names()):
            raise UserError(f"no checkpoint at {path}, and none of that name ships; did you mean {meant}?")
    if path.is_dir():
        path = path / MODEL_FILE
    tensors, header = read_tensors(path, "model")
    with sound(path, FIX):
        trained_on = str(header["config"]["env"])  # before all else: a task of one's own may not be at hand any more
    if env is not None and trained_on != canonical_name(env):
        raise UserError(f"{path} was trained on {trained_on}, not on {env}; give a checkpoint of {env}")
    with sound(path, FIX):
        tensors, header = todays(tensors, {"episodes": 0, "revision": "unknown", **header})
        config = from_dict(header["config"])
        sizes, length = _sizes_and_length(header, config, path)
        _check_networks(tensors, sizes, length, config, path)
        policy, distance = _networks(sizes, length, config)
        has_distance = any(name.startswith("distance.") for name in tensors)
        _load(policy, "policy.", tensors, path)
        if has_distance:
            _load(distance, "distance.", tensors, path)
        visits = _load_visits(tensors, sizes, config.counts.visit_bits, policy, path)
    return Model(distance if has_distance else None, policy, config, header, visits)


FIX = "copy or train it again"


def _networks(sizes: tuple[int, int, int], length: int, config: TrainConfig) -> tuple[Policy, DistanceNetwork]:
    policy: Policy = GaussianPolicy(sizes, config.hidden)
    if config.policy.agent == "ddpg":
        policy = DeterministicPolicy(sizes, config.hidden, config.policy.action_noise)
    return policy, DistanceNetwork(sizes, config.hidden, length, config.distance)


def _check_networks(
    tensors: dict[str, Tensor], sizes: tuple[int, int, int], length: int, config: TrainConfig, path: Path
) -> None:
    """Refuse a header that describes other networks than those in the file, before memory is taken for them."""
    fits = len(config.hidden) * config.distance.n_members <= len(tensors)
    if fits:
        with torch.device("meta"):
            networks = dict(zip(("policy", "distance"), _networks(sizes, length, config), strict=True))
        for prefix, network in networks.items():
            described = {f"{prefix}.{name}": value for name, value in network.state_dict().items()}
            held = {name: value for name, value in tensors.items() if name.startswith(f"{prefix}.")}
            if prefix == "policy" or held:
                fits = fits and described.keys() == held.keys()
                fits = fits and all(held[name].shape == value.shape for name, value in described.items())
                fits = fits and all(value.dtype == torch.float32 for value in held.values())
    if not fits:
        raise UserError(f"{path} does not hold the network its header describes; train it again")


COUNT_TABLE = ("projection", "keys", "counts")


def _narrow(array: np.ndarray) -> np.ndarray:
    """Integers in half the bytes where they fit; the projection as it is, for its signs must not change."""
    fits = array.dtype == np.int64 and array.max(initial=0) <= np.iinfo(np.int32).max
    return array.astype(np.int32) if fits else array


def _sizes_and_length(header: dict[str, Any], config: TrainConfig, path: Path) -> tuple[tuple[int, int, int], int]:
    """Widths and T of the file; of the first format, which has no T, that of the task."""
    length = header.get("episode_length", config.episode_length if header["format"] == OLDER else None)
    numbers = [*header.get("sizes", ()), length]
    if len(numbers) != 4 or not all(type(number) is int and number > 0 for number in numbers):
        raise UserError(f"{path} does not say what sizes and which episode length it was trained with; train it again")
    return (numbers[0], numbers[1], numbers[2]), numbers[3]


def _load_visits(
    tensors: dict[str, Tensor], sizes: tuple[int, int, int], n_bits: int, policy: Policy, path: Path
) -> VisitCounts | None:
    if not any(name.startswith("visits.") for name in tensors):
        return None
    parts = [tensors.get(f"visits.{name}", torch.empty(0, dtype=torch.bool)) for name in COUNT_TABLE]
    fits = parts[0].dtype == torch.float64 and all(part.dtype in (torch.int32, torch.int64) for part in parts[1:])
    fits = fits and parts[0].shape == (sizes[0] + sizes[1] + 1, n_bits) and bool(parts[0].isfinite().all())
    fits = fits and parts[1].ndim == 1 and parts[1].shape == parts[2].shape and bool((parts[2] >= 1).all())
    keys = parts[1].long()
    fits = fits and bool((keys.diff() > 0).all() and (keys >= 0).all() and (keys < 2**n_bits).all())
    if not fits:
        raise UserError(f"{path} does not hold visit counts that fit its header; train it again")
    table = KeyCounts(keys.numpy(), parts[2].long().numpy())
    # Training counts under the networks' own scaling.
    return VisitCounts(SimHash(parts[0].numpy()), table, policy.scaling.numbers())


def _load(network: torch.nn.Module, prefix: str, tensors: dict[str, Tensor], path: Path) -> None:
    weights = {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
    network.load_state_dict(weights)
    if not all(torch.isfinite(value).all() for value in weights.values()):
        raise UserError(f"{path} holds weights that are not finite; train it again")
    network.eval().requires_grad_(False)
