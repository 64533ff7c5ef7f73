"""Figures 3 and 5 from published runs: ``python -m benchmarks.curves``.

Figure 3: success and maximum reward over training episodes, all tasks, four methods. Figure 5:
maximum reward, merging and relaxation rates on pick and place. Lines are interquartile means
over seeds, bands their 95 % bootstrap intervals. A third picture has success on two harder
tasks. Nothing is trained: ``benchmarks.sweep`` does that; cells without a run are said to be
missing.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cells import RESULTS, learning_curves
from benchmarks.command import read_options
from napsp.config import METHODS, preset
from napsp.envs.cards import suite
from napsp.errors import run_command
from napsp.statistics import interquartile_mean
from napsp.storage.record import save_figure

NAMED: dict[str, dict[str, Any]] = {"ours, first arrival": {"method": "ours", "first_arrival": True}}
"""Named options that go beyond the paper's method; shown where they were run."""
LINES: dict[str, dict[str, Any]] = {**{method: {"method": method} for method in METHODS}, **NAMED}
COLORS = dict(zip(LINES, ("tab:gray", "tab:orange", "tab:blue", "tab:red", "tab:purple"), strict=True))
MORE_UPDATES = {
    f"{name}, 2 episodes per iteration": {**options, "episodes_per_iteration": 2} for name, options in LINES.items()
}
"""On pick and place four times the updates per episode: in tables where it was run, not in the figures."""


def line_of(env: str, config_hash: str, n_episodes: int) -> str | None:
    """The method or named option whose preset of so many training episodes has this hash; None for other settings."""
    named = {**MORE_UPDATES, **LINES}  # where both mean the same, the plain name
    hashes = {preset(env, **options, n_episodes=n_episodes).hash(): name for name, options in named.items()}
    return hashes.get(config_hash)


TITLES = {
    "success_rate": "success (last step)",
    "any_success_rate": "success (some step)",
    "max_reward": "maximum reward [m]",
    "merging_rate": "merging rate",
    "relaxation_rate": "relaxation rate",
}


def current_runs(env: str) -> dict[str, list[dict[str, Any]]]:
    """Published runs of a task by method or named option: of today's presets, and of the most episodes among those."""
    longest: dict[tuple[str, int], dict[str, Any]] = {}
    for run in sorted(learning_curves(env), key=lambda run: run["config"]["n_episodes"]):
        name = line_of(env, run["config_hash"], run["config"]["n_episodes"])
        if name is not None:
            longest[name, run["seed"]] = run
    runs: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for (name, _), run in sorted(longest.items()):
        runs[name].append(run)
    for name, group in runs.items():  # seeds of one length: a mean over others would compare different amounts
        most = max(run["config"]["n_episodes"] for run in group)
        runs[name] = [run for run in group if run["config"]["n_episodes"] == most]
    return runs


def recorded(runs: list[dict[str, Any]], column: str) -> list[dict[str, Any]]:
    """Runs that have a column: the oldest ones lack the maximum reward."""
    return [run for run in runs if column in run["curve"][-1]]


def over_seeds(runs: list[dict[str, Any]], column: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Episodes ``(n,)``, interquartile means ``(n,)`` and interval ends ``(2, n)`` (NaN with too few seeds).

    Over the runs that :func:`recorded` the column.
    """
    runs = recorded(runs, column)
    values: dict[float, list[float]] = defaultdict(list)
    for run in runs:
        for row in run["curve"]:
            if column in row:
                values[row["episodes"]].append(row[column])
    episodes = sorted(e for e, v in values.items() if len(v) == len(runs))
    summaries = [interquartile_mean(values[e]) for e in episodes]
    ends = [interval or (np.nan, np.nan) for _, interval in summaries]
    return np.array(episodes), np.array([mean for mean, _ in summaries]), np.array(ends).reshape(-1, 2).T


def draw(axis: Any, runs: dict[str, list[dict[str, Any]]], column: str) -> None:
    """One panel: every method's curve."""
    for method in LINES:
        if runs.get(method):
            episodes, means, ends = over_seeds(runs[method], column)
            if len(episodes):
                label = f"{method} ({len(recorded(runs[method], column))})"
                axis.plot(episodes, means, color=COLORS[method], label=label, linewidth=1.2)
                axis.fill_between(episodes, *ends, color=COLORS[method], alpha=0.15, linewidth=0)
    axis.set(xlabel="episodes", ylabel=TITLES[column])
    if axis.lines:
        axis.legend(fontsize=6, title="method (seeds)", title_fontsize=6)
    else:
        axis.text(0.5, 0.5, "not run", ha="center", transform=axis.transAxes)


def grid(panels: list[tuple[str, str]], n_columns: int, path: Path) -> None:
    """Draw (task, column) panels into one picture."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    n_rows = -(-len(panels) // n_columns)
    figure, axes = plt.subplots(n_rows, n_columns, figsize=(3.1 * n_columns, 2.5 * n_rows), layout="constrained")
    for axis, (env, column) in zip(np.ravel(axes), panels, strict=True):
        draw(axis, current_runs(env), column)
        axis.set_title(env, fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, path)
    print(f"picture: {path}")


@dataclass(frozen=True)
class CurveOptions:
    """Draw figures 3 and 5, and the curves of two harder tasks, from results/runs; there is nothing to choose."""


def main() -> int:
    """Draw the figures; name the cells that were not run."""
    read_options(CurveOptions, "curves")
    for env in suite("paper"):
        missing = [method for method in METHODS if not current_runs(env).get(method)]
        if missing:
            print(f"{env}: not run: {', '.join(missing)}")
    columns = ("success_rate", "max_reward")
    grid([(env, column) for column in columns for env in suite("paper")], len(suite("paper")), RESULTS / "figure3.png")
    grid([(env, "success_rate") for env in suite("harder")], len(suite("harder")), RESULTS / "harder_tasks.png")
    rates = ("max_reward", "merging_rate", "relaxation_rate")
    grid([("fetch_pick_place", column) for column in rates], 3, RESULTS / "figure5.png")
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
