"""Reading the state of a training run, so that it goes on where it was."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from napsp.config import TrainConfig, from_dict
from napsp.data.episodes import FIELDS, Episodes, concatenate
from napsp.distance.counts import KeyCounts
from napsp.errors import UserError
from napsp.learner import Learner
from napsp.settings import changed, differences
from napsp.storage.files import OLDER, read_tensors, sound
from napsp.storage.older import todays_state
from napsp.storage.segments import FOLDER, checked_table, episodes_of, listed, read_episodes, read_segment, refill
from napsp.storage.state import STATE_FILE, TABLE, Stored, agent_tensors, hashes_of, optimizers_of, tables_of

FIX = "put back a copy, or begin anew with --restart"


def read_training(path: Path, config: TrainConfig) -> Stored:
    """Read a training state and check that it belongs to ``config``.

    The number of episodes may differ: a finished run can be prolonged.

    Raises:
        UserError: damaged file, or a run with other settings or episodes of another length.
    """
    try:
        tensors, header = read_tensors(path, "training state")
        if header["format"] == OLDER or "episode_length" not in header:
            raise UserError(f"{path} was written by an older version of napsp; finish it there")
        with sound(path, FIX):
            tensors, header = todays_state(tensors, header)
            different = {"env": config.env}
            if header["config"]["env"] == config.env:  # another one is not to be imported
                different = differences(begun(config, header), from_dict(header["config"]))
    except UserError as error:
        raise UserError(f"{error}, or begin anew with --restart") from None
    named = sorted(name for name in different if name not in ("n_episodes", "recipe"))
    if named:
        raise UserError(
            f"{path.parent} holds a run with other settings ({', '.join(named)}); "
            "choose another --out, or --restart to overwrite it"
        )
    if header["episode_length"] != config.episode_length:  # D, and all distances, are in units of it
        raise UserError(
            f"{path.parent} holds a run with episodes of {header['episode_length']} steps, and {config.env} has "
            f"{config.episode_length} now; put its time limit back, choose another --out, or --restart to overwrite it"
        )
    return tensors, header


def begun(config: TrainConfig, header: Mapping[str, Any]) -> TrainConfig:
    """What a run goes on with that began before an option existed: its way of before."""
    return changed(config, header["inherited"])


def stored_episodes(folder: Path) -> Episodes:
    """D of a run, from its state.

    Raises:
        UserError: there is no state, or it is damaged.
    """
    path = folder / STATE_FILE
    tensors, header = read_tensors(path, "training state")
    with sound(path, FIX):
        tensors, header = todays_state(tensors, header)
        if "buffer.actions" in tensors:
            return _episodes_within(tensors, path)
        span = header["replay"]["start"], header["replay"]["end"]
        return concatenate(list(read_episodes(folder, listed(header["episodes"], "episodes", path), *span)))


def stored_tables(folder: Path) -> dict[str, KeyCounts]:
    """The counts of a run by name, from its state.

    Raises:
        UserError: there is no state, or it is damaged.
    """
    path = folder / STATE_FILE
    tensors, header = read_tensors(path, "training state")
    with sound(path, FIX):
        stored = todays_state(tensors, header)
        if "buffer.actions" in tensors:
            names = [name.removesuffix(".keys") for name in tensors if name.endswith(".keys")]
        else:
            first = read_segment(folder, listed(stored[1]["counts"], "counts", path)[0])
            names = [name.removesuffix(".keys") for name in first if name.endswith(".keys")]
        return _tables(folder, names, stored)


def warmup_episodes(folder: Path, stored: Stored, config: TrainConfig) -> Episodes:
    """The warm-up episodes of a run, whether or not D still has them.

    Raises:
        UserError: they are damaged, or of other sizes than the state says.
    """
    (tensors, header), path = stored, folder / STATE_FILE
    with sound(path, FIX):
        if "buffer.actions" in tensors:
            found = _episodes_within(tensors, path)[: config.n_warmup]
        else:
            segments = listed(header["episodes"], "episodes", path)
            found = concatenate(list(read_episodes(folder, segments, 0, config.n_warmup)))
        sizes = [part.shape[-1] for part in (found.observations, found.actions, found.desired_goals)]
        if sizes != header["sizes"] or found.actions.shape[1] != config.episode_length or len(found) != config.n_warmup:
            raise ValueError("episodes of other sizes")
    return found


def restore_training(folder: Path, learner: Learner, stored: Stored) -> int:
    """Put ``learner`` into the stored state; return the number of iterations done.

    Raises:
        UserError: the state is not that of such a learner, or has lost some of its files.
    """
    (tensors, header), path, config = stored, folder / STATE_FILE, learner.config
    with sound(path, FIX):
        with torch.no_grad():
            for name, value in agent_tensors(learner).items():
                _check(tensors[name], value, name)
                value.copy_(tensors[name])
        for name, optimizer in optimizers_of(learner).items():
            optimizer.load_state_dict({**optimizer.state_dict(), "state": _moments(tensors, name, optimizer)})
        for name, (holder, keys) in hashes_of(learner).items():
            for key in keys:
                _check(tensors[f"{name}.{key}"], torch.from_numpy(getattr(holder, key)), name)
                setattr(holder, key, tensors[f"{name}.{key}"].numpy())
        for name, table in _tables(folder, tables_of(learner), stored).items():
            own = tables_of(learner)[name]
            own.keys, own.counts = table.keys, table.counts
            if "buffer.actions" not in tensors:  # all that is there is in files
                own.watch()
        learner.counts.scaling = learner.distance.distance.scaling.numbers()
        learner.scaled_at, iteration, replay = header["scaled_at"], header["iteration"], header["replay"]
        if replay["end"] != config.n_warmup + iteration * config.episodes_per_iteration:
            raise ValueError(f"{replay['end']} episodes after {iteration} iterations")
        if "buffer.actions" in tensors:
            learner.buffer.extend(_episodes_within(tensors, path)[config.n_warmup :])
        else:
            segments = listed(header["episodes"], "episodes", path)
            refill(folder, segments, replay["start"], replay["end"], learner.buffer)
        learner.buffer.n_seen, learner.buffer.n_steps, learner.buffer.n_blown = _totals(replay)
        if learner.graph is not None and header["graph_built_at"]:
            learner.graph.build(learner.buffer.episodes()[: header["graph_built_at"]], config.seed)
        learner.generator.set_state(tensors["torch_generator"])
        learner.rng.bit_generator.state = header["rng"]
        if not (isinstance(header["seconds"], float) and all(isinstance(word, str) for word in header["revisions"])):
            raise TypeError("seconds or revisions")
    return iteration


def explorers_of(tensors: dict[str, Tensor], n: int) -> list[dict[str, np.ndarray]]:
    """Where each of ``n`` explorers was."""
    prefixes = [f"explorer.{i}." for i in range(n)]
    return [{k.removeprefix(p): v.numpy() for k, v in tensors.items() if k.startswith(p)} for p in prefixes]


def _check(found: Tensor, own: Tensor, name: str) -> None:
    if found.shape != own.shape or found.dtype != own.dtype:
        raise ValueError(f"{name} is {tuple(found.shape)} {found.dtype}, and should be {tuple(own.shape)} {own.dtype}")


def _moments(tensors: dict[str, Tensor], name: str, optimizer: torch.optim.Adam) -> dict[int, dict[str, Tensor]]:
    """What Adam knows of each of its parameters, by their number."""
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    found: dict[int, dict[str, Tensor]] = {}
    for i, parameter in enumerate(parameters):
        if f"{name}.{i}.step" in tensors:  # none before the first update
            found[i] = {key: tensors[f"{name}.{i}.{key}"] for key in ("step", "exp_avg", "exp_avg_sq")}
            for key in ("exp_avg", "exp_avg_sq"):
                _check(found[i][key], parameter, f"{name}.{i}.{key}")
            _check(found[i]["step"], torch.zeros((), dtype=torch.float32), f"{name}.{i}.step")
    return found


def _totals(replay: Mapping[str, int]) -> tuple[int, int, int]:
    totals = replay["end"], replay["steps"], replay["blown"]
    if not all(type(number) is int and number >= 0 for number in totals):
        raise ValueError(f"totals are {totals}")
    return totals


def _tables(folder: Path, names: Iterable[str], stored: Stored) -> dict[str, KeyCounts]:
    """Counts by name: what every save added."""
    (tensors, header), path = stored, folder / STATE_FILE
    if "buffer.actions" in tensors:
        return {name: checked_table(*(tensors[f"{name}.{part}"].numpy() for part in TABLE), path) for name in names}
    found = {name: KeyCounts() for name in names}
    for segment in listed(header["counts"], "counts", path):
        arrays = read_segment(folder, segment)
        for name, table in found.items():
            added = checked_table(*(arrays[f"{name}.{part}"] for part in TABLE), folder / FOLDER / segment.name)
            table.merge(added.keys, added.counts)
    return found


def _episodes_within(tensors: dict[str, Tensor], path: Path) -> Episodes:
    """D of a state of before, which held all of it."""
    return episodes_of({name: tensors[f"buffer.{name}"].numpy() for name in FIELDS}, path)
