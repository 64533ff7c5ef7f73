"""Tables of training: the paper's comparison, shipped checkpoints, distance accuracy, coverage; markdown lines."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cells import RESULTS, read_results
from benchmarks.coverage import CoverageOptions
from benchmarks.curves import LINES, MORE_UPDATES, current_runs
from benchmarks.distance_accuracy import AccuracyOptions
from napsp.config import METHODS, from_dict, preset
from napsp.envs.cards import suite
from napsp.statistics import describe, interquartile_mean
from napsp.storage.record import command_line


def _current(name: str, **sizes: int) -> list[dict[str, str]]:
    """Rows of the present presets and of these sizes; rows of superseded settings stay in the file only."""
    rows = [row for row in read_results(RESULTS / name) if all(row[k] == str(v) for k, v in sizes.items())]
    hashes = {(r["env"], m): preset(r["env"], method=m).hash() for r in rows for m in METHODS}
    return [r for r in rows if r["method"] not in METHODS or r["config_hash"] == hashes[r["env"], r["method"]]]


def training_table() -> list[str]:
    """Final evaluation of the shipped checkpoints."""
    lines = [
        "### Shipped checkpoints",
        "",
        "| task | command | episodes | wall minutes, machine shared | success | d at the goal |",
        "|---|---|---|---|---|---|",
    ]
    for path in sorted(Path("napsp/checkpoints").glob("*/training.json")):
        record = json.loads(path.read_text())
        final = record["final"]
        lines.append(
            f"| {path.parent.name} | `{command_line(from_dict(record['config']))}` | {record['episodes']:.0f} | {record['minutes']:.1f} "
            f"| {final['success_rate']:.2f} | {final.get('distance_at_goal', float('nan')):.1f} |"
        )
    return lines


def learning_table() -> list[str]:
    """Final evaluation of every cell of the paper's comparison, over training seeds."""
    lines = [
        "### The paper's comparison (`python -m benchmarks.sweep`, `python -m benchmarks.curves`)",
        "",
        "![Learning curves of all tasks and methods](results/figure3.png)",
        "",
        "Last evaluation of each training run, on goals that all methods and seeds share; interquartile mean over seeds with its",
        "95 % bootstrap interval (three seeds or more). *Success* is being at the goal in the last step, *maximum reward* the least",
        "distance to the goal in an episode, negated (the oldest runs did not record it). *0.5 first at episode* and its neighbours: the",
        "first evaluation with so much success, median over seeds, and how many of them got there. *First arrival* is",
        "`--first-arrival`, an option that the paper does not have.",
        "The last two tasks are not the paper's, but harder ones.",
        "",
        "![Success on the two harder tasks](results/harder_tasks.png)",
        "",
        "| task | method | seeds | episodes | success | some-step success | maximum reward [m] | 0.5 first at episode | 0.9 | 1.0 |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for env in (*suite("paper"), *suite("harder")):
        runs = current_runs(env)
        for method, options in {**LINES, **MORE_UPDATES}.items():
            if method not in METHODS and not runs.get(method):
                continue
            cells = ["not run", *[""] * 7]
            if runs.get(method):
                last = [run["curve"][-1] for run in runs[method]]
                summaries = [_over_seeds(last, k) for k in ("success_rate", "any_success_rate", "max_reward")]
                first = [_first_at(runs[method], rate) for rate in (0.5, 0.9, 1.0)]
                wanted = preset(env, **options).n_episodes
                done = min(int(row["episodes"]) for row in last)
                length = str(done) if done >= wanted else f"{done} of {wanted}"
                cells = [str(len(last)), length, *summaries, *first]
            lines.append(f"| {env} | {method} | {' | '.join(cells)} |")
    return lines


def _over_seeds(rows: list[dict[str, float]], column: str) -> str:
    """Interquartile mean and interval, and how many rows had the column where not all did."""
    values = [row[column] for row in rows if column in row]
    if not values:
        return "-"
    return describe(*interquartile_mean(values)) + (f" ({len(values)} seeds)" if len(values) < len(rows) else "")


def _first_at(runs: list[dict[str, Any]], rate: float) -> str:
    """Median over seeds of the episode at which success first came to a rate, and how many seeds got there."""
    reached = [[row["episodes"] for row in run["curve"] if row["success_rate"] >= rate] for run in runs]
    first = [episodes[0] if episodes else np.inf for episodes in reached]
    if np.isinf(first).all():
        return "never"
    median = np.median(first)  # half of an odd pair is never
    return f"{f'{median:.0f}' if np.isfinite(median) else 'never'} ({np.isfinite(first).sum()} of {len(runs)})"


def accuracy_table() -> list[str]:
    """Learned distances against exact ones."""
    lines = [
        "### Distance accuracy (`python -m benchmarks.distance_accuracy --env point_maze`)",
        "",
        "d(s, a, g) for states at rest anywhere, uniform actions and goals, against exact shortest-path steps over the real",
        "dynamics (breadth-first search with MuJoCo steps as edges). *Task pairs* lead from the start room to the goal room.",
        "",
        "| task | method | seed | Spearman | Pearson | ratio CV | mean ratio | Spearman, task pairs |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in _current("distance_accuracy.csv", n_states=AccuracyOptions.n_states, n_goals=AccuracyOptions.n_goals):
        figures = [f"{float(row[k]):.2f}" for k in ("spearman", "pearson", "ratio_cv", "mean_ratio", "task_spearman")]
        lines.append(f"| {row['env']} | {row['method']} | {row['seed'] or '-'} | {' | '.join(figures)} |")
    return lines


def coverage_table() -> list[str]:
    """State coverage of the four methods."""
    lines = [
        "### State coverage, figure 6 (`python -m benchmarks.coverage`)",
        "",
        "![State coverage of the four methods in the long maze](results/coverage_point_maze_long.png)",
        "",
        "| task | method | seed | episodes | house covered | goal room covered | success | any-step success |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in _current("coverage.csv", bins=CoverageOptions.bins):
        names = ("coverage", "goal_room_coverage", "success_rate", "any_success_rate")
        figures = [f"{float(row[k]):.2f}" for k in names]
        lines.append(f"| {row['env']} | {row['method']} | {row['seed']} | {row['episodes']} | {' | '.join(figures)} |")
    return lines
