"""Method plus without each of its parts: ``python -m benchmarks.ablation --env point_maze``.

Trains what ``results/runs`` lacks, as ``benchmarks.sweep`` does, and in mazes measures how true the distances are, as
``benchmarks.distance_accuracy`` does. Several processes share the work. ``docs/plus.md`` says what each part is.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from benchmarks.cells import RESULTS, as_text, cell_name, published, replace_results, trained, usual_recipe
from benchmarks.command import read_options
from benchmarks.distance_accuracy import KEY, AccuracyOptions, figures_of, learned_steps, sizes_of, usual_starts
from benchmarks.maze_probe import maze_probe
from napsp import envs as tasks
from napsp.config import TrainConfig, preset
from napsp.errors import UserError, run_command
from napsp.execution import Execution
from napsp.storage.checkpoint import load_model
from napsp.storage.lock import BusyError
from napsp.storage.revision import git_revision

WHOLE = "nothing"
BASE = {"bootstrap.pessimism": "largest"}
"""Parts are left out of plus with all of them: the larger of two is among them where a task's own settings lack it."""
Change = Mapping[str, Any] | Callable[[TrainConfig], Mapping[str, Any]]
GRAPH: dict[str, Change] = {
    "shortest paths and explorers": {"graph.every": 0},
    "explorers": {"explore.explorers": 0.0},
    "three lattices": {"graph.n_lattices": 1},
}
"""Of tasks that have a graph."""
EVERYWHERE: dict[str, Change] = {
    "lasting arrivals": {"bootstrap.stay": 0.0},
    "the larger of two": {"bootstrap.pessimism": "mean"},
    "no more than was seen": {"bootstrap.bound": False},
    "outputs in steps": {"distance.unit": "episode"},
    "relative errors": {"distance.loss": "squared"},
    "third layer": lambda whole: {"hidden": whole.hidden[:-1]},
    "goals of other episodes": {"her.relabel_ratio": 0.8, "her.other_goals_ratio": 0.0},
}
REMOVALS: Mapping[str, Change] = {WHOLE: {}, **GRAPH, **EVERYWHERE}
"""What is left out, and the options that do so; where they depend on it, of plus with all parts."""
OBEDIENT = ("point_maze", "fetch_wall")
MANIPULATION = ("fetch_pick_place",)
TASKS = (*OBEDIENT, *MANIPULATION)
"""The tasks of the table."""


def removals(env: str) -> list[str]:
    """Parts that do something on a task: actions decide at once how its achieved goal changes, or they do not."""
    idle = tuple(GRAPH) if env in MANIPULATION else ("lasting arrivals",)
    return [name for name in REMOVALS if name not in idle]


def without(env: str, part: str, seed: int) -> TrainConfig:
    """The configuration of plus without a part."""
    whole = preset(env, "plus", usual_recipe(env), BASE, seed=seed)
    change = REMOVALS[part]
    changes = change(whole) if callable(change) else change
    return preset(env, "plus", usual_recipe(env), BASE | dict(changes), seed=seed)


@dataclass(frozen=True)
class AblationOptions:
    """Train method plus without each of its parts."""

    env: str = "point_maze"
    """Task: point_maze, fetch_wall or fetch_pick_place."""
    parts: tuple[str, ...] = ()
    """Parts to leave out, one at a time; none named is all that the task has, and nothing: plus with all parts."""
    seeds: int = 3
    """Training seeds 0 .. seeds - 1."""
    compiled: bool = False
    """Compile the losses, see napsp.train."""


def cells(options: AblationOptions) -> Iterator[TrainConfig]:
    """Configurations, all parts of a seed before the next seed."""
    for seed in range(options.seeds):
        for part in options.parts or removals(options.env):
            yield without(options.env, part, seed)


def measure(config: TrainConfig) -> None:
    """Compare a trained maze distance with the exact one; the row lands beside those of the other distances."""
    starts, goals = usual_starts(config.env), AccuracyOptions.n_goals
    model = load_model(trained(config), config.env)
    found = figures_of(maze_probe(config.env, starts, goals), learned_steps(model), np.random.default_rng(0))
    row = {"env": config.env, **sizes_of(starts, goals), "method": config.method, "seed": config.seed,
           "training": as_text(config.identity()), "revision": git_revision(),
           "trained_at": model.header["revision"]}  # fmt: skip
    replace_results(RESULTS / "distance_accuracy.csv", KEY, [row | found])
    print(f"{cell_name(config)}: Spearman {found['spearman']:.3f}, ratio CV {found['ratio_cv']:.3f}", flush=True)


def main() -> int:
    """Train and measure."""
    options = read_options(AblationOptions, "ablation")
    options = replace(options, env=tasks.canonical_name(options.env))
    if options.env not in TASKS:
        raise UserError(f"parts are left out on {', '.join(TASKS)}; give one of them with --env")
    unknown = set(options.parts) - set(removals(options.env))
    if unknown:
        raise UserError(f"no part of plus on {options.env} is called {unknown.pop()!r}; choose from: "
                        f"{', '.join(removals(options.env))}")  # fmt: skip
    torch.set_num_threads(1)
    for config in cells(options):
        if published(config):
            print(f"{cell_name(config)}: already in results", flush=True)
            continue
        try:
            trained(config, Execution(compiled=options.compiled), wait=False)
        except BusyError:
            print(f"{cell_name(config)}: in work elsewhere", flush=True)
            continue
        if config.env.startswith("point_maze"):
            measure(config)
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
