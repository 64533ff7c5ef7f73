"""How true is a distance? ``python -m benchmarks.distance_accuracy --env point_maze``.

In mazes against exact search over the real dynamics, in others against the best known steps
(``benchmarks.best_known``, an upper bound). Rows land in ``results/distance_accuracy.csv``; with ``--methods``
estimates are drawn over the truth beside them. Of ``sparse`` it is the critic, read as steps.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.stats import pearsonr, spearmanr

from benchmarks.best_known import known_probe
from benchmarks.cells import RESULTS, as_text, replace_results, usual_recipe
from benchmarks.command import read_options
from benchmarks.critic_steps import critic_steps
from benchmarks.maze_probe import Probe, maze_probe
from benchmarks.subjects import Subject
from napsp import envs as tasks
from napsp.config import preset
from napsp.errors import UserError, run_command
from napsp.storage.checkpoint import Model, load_model
from napsp.storage.files import write_json
from napsp.storage.record import save_figure
from napsp.storage.revision import git_revision
from napsp.storage.shipped import shipped_model

SHOWN = ("spearman", "pearson", "ratio_cv", "mean_ratio", "triangle_rate", "triangle_rate_step", "distance_at_goal",
         "best_action_rate")  # fmt: skip
AGREEMENT = ("spearman", "mean_ratio", "ratio_cv")
"""What is also said of each kind of pairs."""
BINS = (0, 5, 10, 20, 40, np.inf)
STRAIGHT = "straight line"
WIDE = 4
"""Panels side by side."""
STARTS, STARTS_LONG = 26, 4
"""In each room of a maze, and of the long one."""
KEY = ("env", "method", "training", "seed", "n_starts", "n_goals", "hold")

Steps = Callable[[np.ndarray, np.ndarray | None, np.ndarray], np.ndarray]
"""Estimated steps ``(n,)`` for observations, actions (None: the policy's) and goals."""


@dataclass(frozen=True)
class AccuracyOptions:
    """Compare distances with the truth. Without further options the one that ships for the task is measured."""

    env: str = "point_maze"
    """Task."""
    checkpoint: Path | None = None
    """A file or folder written by napsp.train, or the name of a model that ships."""
    methods: tuple[str, ...] = ()
    """Measure trained cells of these methods instead; missing ones are trained first."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Their training seeds."""
    n_starts: int | None = None
    """Starts in each room of a maze; each costs a search, every fourth one three. Default 26, and 4 in the long maze,
    where a search takes most of a minute."""
    n_goals: int = 8
    """Goals in each room for every start."""
    hold: int = 1
    """Outside mazes: against the steps to arrivals that are held so many control steps, see benchmarks.best_known."""
    json: Path | None = None
    """File for the figures; of several models, their medians."""


def figures_of(probe: Probe, steps: Steps, rng: np.random.Generator) -> dict[str, float]:
    """All figures of one distance."""
    use = np.isfinite(probe.steps)
    truth = probe.steps[use]
    estimate = steps(probe.observations, probe.actions, probe.goals)[use]
    found = agreement(truth, estimate)
    for name, kind in probe.kinds.items():
        part = agreement(truth[kind[use]], estimate[kind[use]])
        found |= {f"{figure}, {name}": part[figure] for figure in AGREEMENT}
    for low, high in itertools.pairwise(BINS):
        inside = (truth > low) & (truth <= high)
        if inside.any():
            found[f"mean error, {low} to {high} steps"] = float((estimate - truth)[inside].mean())
    found["slope_at_goal"] = slope(truth, estimate)
    return found | triangles(probe, steps, rng) | best_actions(probe.alternatives[use], truth, estimate)


def pair_figures(probe: Probe, steps: Steps) -> dict[str, float]:
    """Figures of d(s, pi(s, g), g), the distance of a pair, beside the fewest known steps from s to g.

    A way's first action is worth its steps if its others follow, and a policy may go on otherwise.
    """
    estimate = steps(probe.observations, None, probe.goals)
    found: dict[str, float] = {}
    for name, kind in {"": np.ones(len(estimate), bool), **probe.kinds}.items():
        part = agreement(probe.steps[kind], estimate[kind])
        found |= {", ".join(filter(None, (figure, name, "own action"))): part[figure] for figure in AGREEMENT}
    return found


def agreement(truth: np.ndarray, estimate: np.ndarray) -> dict[str, float]:
    """Rank and linear correlation, mean and coefficient of variation of estimate / truth; NaN where all are alike."""
    if len(truth) < 2 or min(np.ptp(truth), np.ptp(estimate)) == 0:
        return dict.fromkeys(("spearman", "pearson", "ratio_cv", "mean_ratio"), np.nan)
    ratio = estimate / truth
    return {
        "spearman": float(spearmanr(truth, estimate).statistic),
        "pearson": float(pearsonr(truth, estimate).statistic),
        "ratio_cv": float(ratio.std() / ratio.mean()),
        "mean_ratio": float(ratio.mean()),
    }


def slope(truth: np.ndarray, estimate: np.ndarray, within: float = 5.0) -> float:
    """How much a distance rises with a step of truth around the goal: 1 is right; NaN where all there are as far."""
    near = truth <= within
    if not near.any() or np.ptp(truth[near]) == 0:
        return np.nan
    return float(np.polyfit(truth[near], estimate[near], 1)[0])


def triangles(probe: Probe, steps: Steps, rng: np.random.Generator, n: int = 20_000) -> dict[str, float]:
    """Shares of d(x, z) > d(x, y) + d(y, z) between random places, by anything and by a step; d at the goal."""
    x, y, z = (rng.integers(len(probe.places), size=n) for _ in range(3))
    action = rng.uniform(-1.0, 1.0, (n, probe.actions.shape[1])).astype(np.float32)
    whole, first = (steps(probe.places[x], action, probe.achieved[end]) for end in (z, y))
    excess = whole - first - steps(probe.places[y], None, probe.achieved[z])
    there = steps(probe.places, None, probe.achieved)
    return {"triangle_rate": float((excess > 1e-4).mean()), "triangle_rate_step": float((excess > 1.0).mean()),
            "distance_at_goal": float(there.mean())}  # fmt: skip


def best_actions(alternatives: np.ndarray, truth: np.ndarray, estimate: np.ndarray) -> dict[str, float]:
    """How often the action of least d among some is one of the truly best, where they differ; and by chance."""
    order = np.argsort(alternatives, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(alternatives[order])) + 1)
    groups = [group for group in groups if np.ptp(truth[group]) > 0]
    if not groups:
        return {"best_action_rate": np.nan, "best_action_rate_by_chance": np.nan}
    best = [truth[group] == truth[group].min() for group in groups]
    hits = [among[np.argmin(estimate[group])] for among, group in zip(best, groups, strict=True)]
    return {
        "best_action_rate": float(np.mean(hits)),
        "best_action_rate_by_chance": float(np.mean([b.mean() for b in best])),
    }


def learned_steps(model: Model) -> Steps:
    """The d of a model."""

    def steps(observations: np.ndarray, actions: np.ndarray | None, goals: np.ndarray) -> np.ndarray:
        assert model.distance is not None
        with torch.inference_mode():
            rows = [torch.from_numpy(np.asarray(part, np.float32)) for part in (observations, goals)]
            chosen = model.policy.mode(*rows) if actions is None else torch.from_numpy(actions.astype(np.float32))
            return model.distance.steps(rows[0], chosen, rows[1]).numpy().astype(np.float64)

    return steps


def straight_steps(env_name: str, probe: Probe) -> Steps:
    """Straight line between the achieved goal and the goal, at the task's speed; blind to the action."""
    length = tasks.make(env_name).unwrapped.step_length
    rows = {observation.tobytes(): goal for observation, goal in zip(probe.places, probe.achieved, strict=True)}
    size = probe.achieved.shape[1]

    def steps(observations: np.ndarray, actions: np.ndarray | None, goals: np.ndarray) -> np.ndarray:
        here = np.stack([rows.get(row.tobytes(), row[:size]) for row in observations])
        return np.linalg.norm(here - goals, axis=1) / length

    return steps


def draw(path: Path, panels: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    """Estimates over true steps, a panel for each distance."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    columns = min(len(panels), WIDE)
    lines = -(-len(panels) // columns)
    figure, axes = plt.subplots(lines, columns, figsize=(3 * columns, 3 * lines), layout="constrained", squeeze=False)
    most = max(truth[np.isfinite(truth)].max() for truth, _ in panels.values())
    for axis in axes.flat[len(panels) :]:
        axis.axis("off")
    for axis, (name, (truth, estimate)) in zip(axes.flat, panels.items(), strict=False):
        use = np.isfinite(truth)
        jitter = np.random.default_rng(0).uniform(-0.4, 0.4, use.sum())  # true steps are whole numbers
        axis.scatter(truth[use] + jitter, estimate[use], s=2, alpha=0.25, linewidths=0, rasterized=True)
        axis.plot([0, most], [0, most], color="black", linewidth=0.8)
        axis.set(title=name, xlabel="true steps", ylabel="steps estimated", xlim=(0, most + 1), ylim=(0, 1.5 * most))
    save_figure(figure, path)


def usual_starts(env_name: str) -> int:
    """Starts in each room of a maze, unless asked otherwise."""
    return STARTS_LONG if env_name == "point_maze_long" else STARTS


def sizes_of(n_starts: int | str = "", n_goals: int | str = "", hold: int | str = "") -> dict[str, Any]:
    """What a row says of the truth it was measured against: that of a maze, or known ways."""
    return {"n_starts": n_starts, "n_goals": n_goals, "hold": hold}


def subjects(options: AccuracyOptions, env_name: str) -> Iterator[Subject]:
    """Whom to measure."""
    if not options.methods:
        yield Subject.existing(env_name, options.checkpoint or shipped_model(env_name).parent)
    for method in options.methods:
        for seed in options.seeds:
            yield Subject.of(preset(env_name, method, usual_recipe(env_name), seed=seed))


def main() -> int:
    """Measure, print, keep."""
    options = read_options(AccuracyOptions, "distance_accuracy")
    if options.methods and options.checkpoint:
        raise UserError("--checkpoint and --methods exclude each other; give one of them")
    env_name = tasks.canonical_name(options.env)
    torch.set_num_threads(1)
    wanted = list(subjects(options, env_name))  # one that is impossible is named before others are trained
    in_maze = env_name.startswith("point_maze")
    if in_maze and options.hold > 1:
        raise UserError(f"{env_name} is measured against exact first arrivals; leave out --hold")
    n_starts = usual_starts(env_name) if options.n_starts is None else options.n_starts
    probe = maze_probe(env_name, n_starts, options.n_goals) if in_maze else known_probe(env_name, options.hold)
    chosen = [(subject, load_model(subject.checkpoint(), env_name)) for subject in wanted]
    known = probe.steps[np.isfinite(probe.steps)]
    n_ways = "" if in_maze else int(probe.kinds["from the start"].sum())
    print(f"{env_name}: {len(known)} pairs, {known.mean():.1f} steps in the mean")
    print("method          seed  " + "  ".join(name.rjust(18) for name in SHOWN))
    sizes = sizes_of(n_starts, options.n_goals) if in_maze else sizes_of(hold=options.hold)
    line = straight_steps(env_name, probe)
    panels = {STRAIGHT: (probe.steps, line(probe.observations, probe.actions, probe.goals))}
    straight = figures_of(probe, line, np.random.default_rng(0))
    rows = [{"method": STRAIGHT, "seed": "", "training": "", "revision": git_revision(), **straight}]
    for subject, model in chosen:
        steps = learned_steps(model) if model.distance else critic_steps(subject.checkpoint(), model)
        found = figures_of(probe, steps, np.random.default_rng(0))
        found |= {} if in_maze else pair_figures(probe, steps)
        name = f"{subject.training['method']}, seed {subject.seed}"
        panels.setdefault(name, (probe.steps, steps(probe.observations, probe.actions, probe.goals)))
        rows.append({"method": subject.training["method"], "seed": subject.seed, "training": as_text(subject.training),
                     "revision": git_revision(), "trained_at": model.header["revision"], **found})  # fmt: skip
    for row in rows:
        print(f"{row['method']:14s}  {row['seed']!s:>4s}  " + "  ".join(f"{row[name]:18.3f}" for name in SHOWN))
    replace_results(
        RESULTS / "distance_accuracy.csv", KEY, [{"env": env_name, **sizes, "n_ways": n_ways, **row} for row in rows]
    )
    if options.methods:
        shown = [STRAIGHT, *(f"{method}, seed {options.seeds[0]}" for method in options.methods)]
        draw(RESULTS / f"distance_accuracy_{env_name}.png", {name: panels[name] for name in shown if name in panels})
    if options.json is not None:
        learned: list[dict[str, Any]] = rows[-len(chosen) :]
        names = [name for name, value in learned[0].items() if isinstance(value, float)]
        numbers = {name: [row[name] for row in learned] for name in names}
        medians = {name: float(np.median(values)) for name, values in numbers.items() if np.isfinite(values).all()}
        write_json(options.json, {"env": env_name, "models": len(chosen), **medians})
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
