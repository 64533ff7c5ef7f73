"""How fast and how surely a method learns: ``python -m benchmarks.learning --env fetch_reach``.

Runs that do not exist yet are trained first; rows go to ``results/learning.csv``.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass

import numpy as np
import tyro

from benchmarks.cells import RESULTS, append_result, find, read_results, trained
from napsp import envs as tasks
from napsp.config import preset
from napsp.errors import run_command
from napsp.progress import read_rows


@dataclass(frozen=True)
class LearningOptions:
    """Summarise training runs."""

    env: str = "fetch_reach"
    """Task."""
    methods: tuple[str, ...] = ("ours",)
    """Methods."""
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    """Training seeds."""


def main() -> int:
    """Train what is missing, summarise, append rows."""
    options = tyro.cli(LearningOptions, prog="python -m benchmarks.learning")
    env_name, path = tasks.canonical_name(options.env), RESULTS / "learning.csv"
    for method in options.methods:
        for seed in options.seeds:
            config = preset(env_name, method=method, seed=seed)
            folder = trained(config)
            rows = read_rows(folder / "metrics.csv", np.inf)
            full = [row["episodes"] for row in rows if row["success_rate"] == 1.0]
            figures = {
                "first_full_success": int(full[0]) if full else "",
                "success_rate": rows[-1]["success_rate"],
                "any_success_rate": rows[-1]["any_success_rate"],
                "best_any_success_rate": max(row["any_success_rate"] for row in rows),
                "episodes": int(rows[-1]["episodes"]),
                "minutes": round(rows[-1]["seconds"] / 60, 2),
            }
            key = {"env": env_name, "method": method, "seed": seed, "config_hash": config.hash()}
            if find(read_results(path), key) is None:
                revision = json.loads((folder / "training.json").read_text())["revision"]
                append_result(path, {**key, "revision": revision, **figures})
            print("  ".join([f"{env_name} {method} seed {seed}", *(f"{k} {v}" for k, v in figures.items())]))
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
