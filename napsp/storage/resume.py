"""The whole state of a training run on disk, so that a killed run goes on where it was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from napsp.config import TrainConfig, from_dict, to_dict
from napsp.data.episodes import FIELDS, Episodes
from napsp.errors import UserError
from napsp.learner import Learner
from napsp.settings import differences
from napsp.storage.files import FORMAT, read_tensors, write_tensors

STATE_FILE = "training_state.safetensors"


def save_training(
    path: Path,
    learner: Learner,
    iteration: int,
    seconds: float,
    revisions: list[str],
    explorers: Sequence[Mapping[str, np.ndarray]] = (),
) -> None:
    """Write networks, optimisers, counts, D, random states and where explorers are after ``iteration`` iterations."""
    tensors: dict[str, Tensor] = {"torch_generator": learner.generator.get_state(), **_agent_tensors(learner)}
    for name, optimizer in _optimizers(learner).items():
        for i, moments in optimizer.state_dict()["state"].items():
            tensors |= {f"{name}.{i}.{key}": value for key, value in moments.items()}
    for name, array in _arrays(learner).items():
        tensors[name] = torch.from_numpy(np.ascontiguousarray(array))
    for i, place in enumerate(explorers):
        tensors |= {f"explorer.{i}.{name}": torch.from_numpy(np.array(values)) for name, values in place.items()}
    header = {
        "format": FORMAT,
        "kind": "training state",
        "config": to_dict(learner.config),
        "episode_length": learner.config.episode_length,
        "iteration": iteration,
        "seconds": seconds,
        "scaled_at": learner.scaled_at,
        "graph_built_at": learner.graph.built_at if learner.graph else 0,
        "revisions": revisions,
        "rng": learner.rng.bit_generator.state,
    }
    write_tensors(path, tensors, header)


def read_training(path: Path, config: TrainConfig) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read a training state and check that it belongs to ``config``.

    The number of episodes may differ: a finished run can be prolonged.

    Raises:
        UserError: damaged file, or a run with other settings or episodes of another length.
    """
    try:
        tensors, header = read_tensors(path, "training state")
        if header["format"] != FORMAT or "episode_length" not in header:
            raise UserError(f"{path} was written by an older version of napsp; finish it there")
        saved = from_dict(header["config"])
    except UserError as error:
        raise UserError(f"{error}, or begin anew with --restart") from None
    different = sorted(name for name in differences(config, saved) if name not in ("n_episodes", "recipe"))
    if different:
        raise UserError(
            f"{path.parent} holds a run with other settings ({', '.join(different)}); "
            "choose another --out, or --restart to overwrite it"
        )
    if header["episode_length"] != config.episode_length:  # D, and all distances, are in units of it
        raise UserError(
            f"{path.parent} holds a run with episodes of {header['episode_length']} steps, and {config.env} has "
            f"{config.episode_length} now; put its time limit back, choose another --out, or --restart to overwrite it"
        )
    return tensors, header


def warmup_episodes(tensors: dict[str, Tensor], config: TrainConfig) -> Episodes:
    """The warm-up episodes: the first ones of the stored D."""
    return Episodes(**{name: tensors[f"buffer.{name}"][: config.n_warmup].numpy() for name in FIELDS})


def restore_training(learner: Learner, tensors: dict[str, Tensor], header: dict[str, Any]) -> int:
    """Put ``learner`` into the stored state; return the number of iterations done."""
    with torch.no_grad():
        for name, value in _agent_tensors(learner).items():
            value.copy_(tensors[name])
    for name, optimizer in _optimizers(learner).items():
        state: dict[int, dict[str, Tensor]] = {}
        for key, value in tensors.items():
            if key.startswith(f"{name}."):
                i, moment = key.removeprefix(f"{name}.").split(".")
                state.setdefault(int(i), {})[moment] = value
        optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
    stored = Episodes(**{name: tensors[f"buffer.{name}"].numpy() for name in FIELDS})
    n_missing = len(stored) - len(learner.buffer)
    if n_missing:
        learner.buffer.extend(stored[-n_missing:])
    for name, holder in _counts(learner).items():
        for key in holder[1]:
            setattr(holder[0], key, tensors[f"{name}.{key}"].numpy())
    learner.counts.scaling, learner.scaled_at = learner.distance.distance.scaling.numbers(), header["scaled_at"]
    if learner.graph is not None and header["graph_built_at"]:
        learner.graph.build(learner.buffer.episodes()[: header["graph_built_at"]], learner.config.seed)
    learner.generator.set_state(tensors["torch_generator"])
    learner.rng.bit_generator.state = header["rng"]
    return int(header["iteration"])


def explorers_of(tensors: dict[str, Tensor], n: int) -> list[dict[str, np.ndarray]]:
    """Where each of ``n`` explorers was."""
    prefixes = [f"explorer.{i}." for i in range(n)]
    return [{k.removeprefix(p): v.numpy() for k, v in tensors.items() if k.startswith(p)} for p in prefixes]


def _networks(learner: Learner) -> dict[str, torch.nn.Module]:
    return {**learner.distance.networks(), **learner.agent.networks()}


def _optimizers(learner: Learner) -> dict[str, torch.optim.Adam]:
    return {"distance_optimizer": learner.distance.optimizer, **learner.agent.optimizers}


def _agent_tensors(learner: Learner) -> dict[str, Tensor]:
    """All numbers of the networks, and what else the agent learns."""
    tensors = {f"{n}.{key}": value for n, net in _networks(learner).items() for key, value in net.state_dict().items()}
    return tensors | {f"agent.{name}": value for name, value in learner.agent.tensors().items()}


def _counts(learner: Learner) -> dict[str, tuple[Any, tuple[str, ...]]]:
    """What holds the counts and their hashes, by name, with the arrays of each."""
    counts, found = learner.counts, {}
    found["visits.hash"], found["visits"] = (counts.visit_hash, ("projection",)), (counts.visit_table, TABLE)
    for i, reached in enumerate(counts.reached_tables):
        found[f"reached.{i}.pair"] = reached.pair, ("projection",)
        found[f"reached.{i}"] = reached, ("shift", "multipliers")
        found[f"reached.{i}.table"] = reached.table, TABLE
    return found


TABLE = ("keys", "counts")


def _arrays(learner: Learner) -> dict[str, np.ndarray]:
    episodes = learner.buffer.episodes()
    arrays = {f"buffer.{name}": getattr(episodes, name) for name in FIELDS}
    for name, (holder, keys) in _counts(learner).items():
        arrays |= {f"{name}.{key}": getattr(holder, key) for key in keys}
    return arrays
