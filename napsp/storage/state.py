"""Writing the whole state of a training run, again and again; each time what is new.

One file has networks, optimisers, random states and where explorers are, and names the files of
:mod:`napsp.storage.segments` that have the episodes of D and the counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from napsp.config import to_dict
from napsp.data.episodes import Episodes
from napsp.distance.counts import KeyCounts
from napsp.learner import Learner
from napsp.storage.files import STATE_FORMAT, write_tensors
from napsp.storage.segments import Segment, described, listed, remove_segments, write_episodes, write_segment

STATE_FILE = "training_state.safetensors"
Stored = tuple[dict[str, Tensor], dict[str, Any]]
"""Tensors and header of a state file."""


class TrainingState:
    """The state of a run on disk.

    Args:
        folder: the run's.
        stored: what the folder holds of it, by :func:`napsp.storage.resume.read_training`; None for a new run.
    """

    def __init__(self, folder: Path, stored: Stored | None = None) -> None:
        self._folder, header = folder, stored[1] if stored else {}
        self._episodes = listed(header.get("episodes", ()), "episodes", folder / STATE_FILE)
        self._counts = listed(header.get("counts", ()), "counts", folder / STATE_FILE)
        self._inherited = header.get("inherited", {})

    def save(
        self,
        learner: Learner,
        iteration: int,
        seconds: float,
        revisions: list[str],
        explorers: Sequence[Mapping[str, np.ndarray]] = (),
    ) -> None:
        """Write networks, optimisers, counts, D, random states and where explorers are after ``iteration`` iterations.

        The last state stands until the new one is complete.
        """
        buffer, warmup = learner.buffer, warmup_of(learner)
        start = buffer.n_seen - len(buffer)
        written = self._episodes or write_episodes(self._folder, warmup, 0)
        first = max(written[-1].end, start)
        written = [*written, *write_episodes(self._folder, buffer.episodes(buffer.n_seen - first), first)]
        # The warm-up stays: a resumed run builds its parts from it.
        episodes = [part for part in written if part.end > start or part.start < len(warmup)]
        counts = self._all_counts(learner)
        header = {
            "format": STATE_FORMAT,
            "kind": "training state",
            "config": to_dict(learner.config),
            "episode_length": learner.config.episode_length,
            "sizes": [part.shape[-1] for part in (warmup.observations, warmup.actions, warmup.desired_goals)],
            "iteration": iteration,
            "seconds": seconds,
            "scaled_at": learner.scaled_at,
            "graph_built_at": learner.graph.built_at if learner.graph else 0,
            "replay": {"start": start, "end": buffer.n_seen, "steps": buffer.n_steps, "blown": buffer.n_blown},
            "episodes": described(episodes),
            "counts": described(counts),
            "inherited": self._inherited,
            "revisions": revisions,
            "rng": learner.rng.bit_generator.state,
        }
        write_tensors(self._folder / STATE_FILE, _tensors(learner, explorers), header)
        self._episodes, self._counts = episodes, counts
        for table in tables_of(learner).values():
            table.watch()
        remove_segments(self._folder, [*episodes, *counts])

    def _all_counts(self, learner: Learner) -> list[Segment]:
        """Write what was counted since the last save; or all, once the files with that have grown beyond all."""
        tables, end = tables_of(learner), learner.buffer.n_seen
        news = {name: table.news for name, table in tables.items() if table.news is not None}
        grown = _size(news) + sum(part.size for part in self._counts[1:])
        if self._counts and len(news) == len(tables) and grown <= _size(tables):
            return [*self._counts, self._write_counts(self._counts[-1].end, end, news)]
        return [self._write_counts(0, end, tables)]

    def _write_counts(self, start: int, end: int, tables: Mapping[str, KeyCounts]) -> Segment:
        arrays = {f"{name}.{part}": getattr(table, part) for name, table in tables.items() for part in TABLE}
        return write_segment(self._folder, "counts", start, end, arrays)


TABLE = ("keys", "counts")


def _size(tables: Mapping[str, KeyCounts]) -> int:
    return sum(table.keys.nbytes + table.counts.nbytes for table in tables.values())


def warmup_of(learner: Learner) -> Episodes:
    """The first episodes of D, which its parts were built from."""
    return learner.buffer.episodes() if learner.warmup is None else learner.warmup


def networks_of(learner: Learner) -> dict[str, torch.nn.Module]:
    """All networks by name."""
    return {**learner.distance.networks(), **learner.agent.networks()}


def optimizers_of(learner: Learner) -> dict[str, torch.optim.Adam]:
    """All optimisers by name."""
    return {"distance_optimizer": learner.distance.optimizer, **learner.agent.optimizers}


def agent_tensors(learner: Learner) -> dict[str, Tensor]:
    """All numbers of the networks, and what else the agent learns."""
    networks = networks_of(learner).items()
    tensors = {f"{name}.{key}": value for name, network in networks for key, value in network.state_dict().items()}
    return tensors | {f"agent.{name}": value for name, value in learner.agent.tensors().items()}


def hashes_of(learner: Learner) -> dict[str, tuple[Any, tuple[str, ...]]]:
    """What turns states into keys of the counts, by name, with the arrays of each."""
    counts, found = learner.counts, {}
    found["visits.hash"] = counts.visit_hash, ("projection",)
    for i, reached in enumerate(counts.reached_tables):
        found[f"reached.{i}.pair"] = reached.pair, ("projection",)
        found[f"reached.{i}"] = reached, ("shift", "multipliers")
    return found


def tables_of(learner: Learner) -> dict[str, KeyCounts]:
    """The counts by name."""
    reached = {f"reached.{i}.table": reached.table for i, reached in enumerate(learner.counts.reached_tables)}
    return {"visits": learner.counts.visit_table, **reached}


def _tensors(learner: Learner, explorers: Sequence[Mapping[str, np.ndarray]]) -> dict[str, Tensor]:
    tensors: dict[str, Tensor] = {"torch_generator": learner.generator.get_state(), **agent_tensors(learner)}
    for name, optimizer in optimizers_of(learner).items():
        for i, moments in optimizer.state_dict()["state"].items():
            tensors |= {f"{name}.{i}.{key}": value for key, value in moments.items()}
    for name, (holder, keys) in hashes_of(learner).items():
        tensors |= {f"{name}.{key}": torch.from_numpy(np.ascontiguousarray(getattr(holder, key))) for key in keys}
    for i, place in enumerate(explorers):
        tensors |= {f"explorer.{i}.{name}": torch.from_numpy(np.array(values)) for name, values in place.items()}
    return tensors
