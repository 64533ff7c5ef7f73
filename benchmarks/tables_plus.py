"""Table of method plus without each of its parts; markdown lines."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.ablation import TASKS, removals, without
from benchmarks.cells import RESULTS, as_text, learning_curves, read_results
from benchmarks.tables_training import first_at
from napsp.config import identity_of
from napsp.statistics import describe, interquartile_mean

LAST = 5  # evaluations


def held(run: dict[str, Any]) -> float:
    """Mean success of the last evaluations: one alone can be luck."""
    return float(np.mean([row["success_rate"] for row in run["curve"][-LAST:]]))


def ablation_runs(env: str, part: str) -> list[dict[str, Any]]:
    """Published runs of plus without a part."""
    identity = without(env, part, 0).identity()
    return [run for run in learning_curves(env) if identity_of(run["config"]) == identity]


def ablation_rows() -> list[dict[str, Any]]:
    """The runs of :func:`ablation_table`."""
    return [run for env in TASKS for part in removals(env) for run in ablation_runs(env, part)]


def ablation_table() -> list[str]:
    """What each part of plus is worth."""
    lines = [
        "### Method plus without each of its parts (`python -m benchmarks.ablation --env point_maze`)",
        "",
        f"*Success held* is the mean of the last {LAST} evaluations, over seeds its interquartile mean and 95 % bootstrap interval (three",
        "seeds or more); Spearman and ratio CV are of d against exact steps. Parts are explained in [docs/plus.md](docs/plus.md).",
        "In pick and place plus itself goes without *the larger of two*.",
        "",
        "| task | without | seeds | success held | 0.9 first at episode | Spearman | ratio CV |",
        "|---|---|---|---|---|---|---|",
    ]
    accuracy = [row for row in read_results(RESULTS / "distance_accuracy.csv") if row["n_starts"]]  # of mazes
    measured = {(row["training"], row["seed"]): row for row in accuracy}
    for env in TASKS:
        for part in removals(env):
            identity, runs = without(env, part, 0).identity(), ablation_runs(env, part)
            if not runs:
                lines.append(f"| {env} | {part} | not run | | | | |")
                continue
            cells = [describe(*interquartile_mean([held(run) for run in runs])), first_at(runs, 0.9)]
            rows = [measured.get((as_text(identity), str(run["seed"]))) for run in runs]
            for name in ("spearman", "ratio_cv"):
                values = [float(row[name]) for row in rows if row]
                cells.append(describe(*interquartile_mean(values), 3 if name == "spearman" else 2) if values else "-")
            lines.append(f"| {env} | {part} | {len(runs)} | {' | '.join(cells)} |")
    return lines
