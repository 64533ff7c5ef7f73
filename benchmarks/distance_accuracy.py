"""How true is the learned distance? ``python -m benchmarks.distance_accuracy --env point_maze``.

Compares d(s, a, g) of ddl, offpolicy_ddl and ours with exact shortest-path steps over the real
dynamics of the maze, with the straight line beside them. States are at rest anywhere in the
house, actions uniform, goals anywhere: a strict test, off the data that a policy collects.
Runs that do not exist yet are trained first (minutes each).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.stats import pearsonr, spearmanr

from benchmarks.cells import RESULTS, append_result, as_text, checkpoint_of, find, read_results
from benchmarks.command import read_options
from benchmarks.maze_truth import MazeSearch
from napsp import envs as tasks
from napsp.config import preset
from napsp.errors import UserError, run_command
from napsp.storage.checkpoint import load_model
from napsp.storage.revision import git_revision

METHODS = ("ddl", "offpolicy_ddl", "ours")
SHOWN = ("spearman", "pearson", "ratio_cv", "mean_ratio", "task_spearman")


@dataclass(frozen=True)
class AccuracyOptions:
    """Compare learned distances with exact ones."""

    env: str = "point_maze"
    """point_maze or point_maze_long."""
    seeds: tuple[int, ...] = (0,)
    """Training seeds."""
    n_states: int = 24
    """Start states; each costs one search."""
    n_goals: int = 200
    """Goals per state."""


@dataclass(frozen=True)
class Probe:
    """Triples with their true distance: ``(n,)`` rows of s, a, g, steps, and whether task-like."""

    states: np.ndarray
    actions: np.ndarray
    goals: np.ndarray
    steps: np.ndarray
    on_task: np.ndarray


def make_probe(env_name: str, n_states: int, n_goals: int, seed: int = 0) -> Probe:
    """Draw states, actions and goals in free space and search for the exact steps."""
    world: Any = tasks.make(env_name).unwrapped
    rng, search = np.random.default_rng(seed), MazeSearch(world)

    def free_points(n: int) -> np.ndarray:
        points = rng.uniform(-0.9, 0.9, (4 * n, 2))
        return points[(np.abs(points) > 0.1).all(1)][:n] * world.scale

    parts = []
    for position in free_points(n_states):
        state = np.concatenate([position, np.zeros(2)])
        action, goals = rng.uniform(-1.0, 1.0, 2), free_points(n_goals)
        following = search.step(state[None], action[None])[0]
        steps = 1.0 + search.steps_to(following, goals)
        on_task = (position < 0).all() & (goals > 0).all(1)  # from the start room to the goal room
        parts.append((np.tile(state, (n_goals, 1)), np.tile(action, (n_goals, 1)), goals, steps, on_task))
    search.close()
    return Probe(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def agreement(probe: Probe, estimate: np.ndarray) -> dict[str, float]:
    """Rank and linear correlation, coefficient of variation and mean of estimate / truth."""
    use = np.isfinite(probe.steps)
    truth, estimate, on_task = probe.steps[use], estimate[use], probe.on_task[use]
    ratio = estimate / truth
    return {
        "spearman": float(spearmanr(truth, estimate).statistic),
        "pearson": float(pearsonr(truth, estimate).statistic),
        "ratio_cv": float(ratio.std() / ratio.mean()),
        "mean_ratio": float(ratio.mean()),
        "task_spearman": float(spearmanr(truth[on_task], estimate[on_task]).statistic),
        "n": float(use.sum()),
    }


def main() -> int:
    """Train what is missing, compare, print, append to results/distance_accuracy.csv."""
    options = read_options(AccuracyOptions, "distance_accuracy", n_goals=2)
    env_name = tasks.canonical_name(options.env)
    if not env_name.startswith("point_maze"):
        raise UserError(f"exact shortest paths exist for point_maze and point_maze_long only, not for {env_name}")
    torch.set_num_threads(1)
    path = RESULTS / "distance_accuracy.csv"
    configs = [preset(env_name, method=method, seed=seed) for method in METHODS for seed in options.seeds]
    models = {(c.method, c.seed): (load_model(checkpoint_of(c), env_name), c) for c in configs}
    probe = make_probe(env_name, options.n_states, options.n_goals)
    print(
        f"{env_name}: {int(np.isfinite(probe.steps).sum())} triples, mean true distance {probe.steps.mean():.1f} steps"
    )
    print("method          seed  " + "  ".join(name.rjust(13) for name in SHOWN))
    straight = np.linalg.norm(probe.states[:, :2] - probe.goals, axis=1) / tasks.make(env_name).unwrapped.step_length
    figures = agreement(probe, straight)
    _show("euclidean", "-", figures)
    sizes = {"n_states": options.n_states, "n_goals": options.n_goals}
    key = {"env": env_name, "method": "euclidean", "seed": "", "training": "", **sizes}
    if find(read_results(path), key) is None:
        append_result(path, {**key, "revision": git_revision(), **figures})
    for (method, seed), (model, config) in models.items():
        rows = [torch.from_numpy(x.astype(np.float32)) for x in (probe.states, probe.actions, probe.goals)]
        assert model.distance is not None
        with torch.inference_mode():
            figures = agreement(probe, model.distance.steps(*rows).numpy().astype(np.float64))
        _show(method, seed, figures)
        key = {"env": env_name, "method": method, "seed": seed, "training": as_text(config.identity()), **sizes}
        if find(read_results(path), key) is None:
            append_result(path, {**key, "revision": model.header["revision"], **figures})
    return 0


def _show(method: str, seed: object, figures: dict[str, float]) -> None:
    print(f"{method:14s}  {seed!s:>4s}  " + "  ".join(f"{figures[name]:13.3f}" for name in SHOWN), flush=True)


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
