"""Which cost plans? ``python -m benchmarks.distance_as_cost --env fetch_wall``.

MPPI with the learned distance (along the plan, at its end), the straight line, and the policy
alone, on the same episodes, for checkpoints of several training seeds. Cells that are already in
``results/distance_as_cost.csv`` are not run again.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

from benchmarks.cells import RESULTS, append_result, find, read_results, trained
from napsp import envs as tasks
from napsp.checkpoint import git_revision, load_model
from napsp.config import preset
from napsp.episodes import evaluate
from napsp.errors import UserError, run_command
from napsp.greedy import GreedyPolicy
from napsp.statistics import describe, wilson_interval
from planners.options import OPTIONS, PlanOptions
from planners.session import Session

VARIANTS: dict[str, dict[str, Any]] = {
    "distance, mean along the plan": {"cost": "distance", "where": "mean"},
    "euclidean, mean along the plan": {"cost": "euclidean", "where": "mean"},
    "policy alone": {},
    "distance, end of the plan": {"cost": "distance", "where": "terminal"},
    "distance, mean, no policy proposals": {"cost": "distance", "where": "mean", "proposals": False},
}


@dataclass(frozen=True)
class CostOptions:
    """Compare costs for planning on one task."""

    env: str = "fetch_wall"
    """Task."""
    training_seeds: tuple[int, ...] = (0, 1, 2)
    """Checkpoints of these training seeds; missing ones are trained first."""
    episodes: int = 50
    """Episodes per cell."""
    seed: int = 80_000
    """First episode seed; these seeds were never used for tuning."""
    samples: int = 64
    """Samples of the planner."""


def plan_episodes(session: Session, seeds: list[int]) -> tuple[list[bool], list[int], float]:
    """Success per episode, first hits, and median milliseconds per plan."""
    results = [session.run_episode(seed) for seed in seeds]
    hits = [r.first_hit for r in results if r.first_hit is not None]
    return [r.success for r in results], hits, float(np.median(np.concatenate([r.plan_ms for r in results])))


def plan_options(env_name: str, variant: str, checkpoint: Path | None, options: CostOptions) -> PlanOptions:
    """The planner of a cell."""
    return OPTIONS["mppi"](
        env=env_name, samples=options.samples, seed=options.seed, checkpoint=checkpoint, **VARIANTS[variant]
    )


def run_cell(env_name: str, variant: str, checkpoint: Path | None, options: CostOptions) -> dict[str, Any]:
    """Run one cell of the table."""
    seeds = [options.seed + i for i in range(options.episodes)]
    if variant == "policy alone":
        assert checkpoint is not None
        model, env = load_model(checkpoint, env_name), tasks.make(env_name)
        result, _ = evaluate([env], GreedyPolicy(model.policy), seeds, model.config.horizon)
        success, hits = result.reached[:, -1].tolist(), result.first_hits[~np.isnan(result.first_hits)].tolist()
        milliseconds = 0.0
    else:
        session = Session.open("mppi", plan_options(env_name, variant, checkpoint, options))
        success, hits, milliseconds = plan_episodes(session, seeds)
        session.close()
    return {
        "success_rate": float(np.mean(success)),
        "any_success_rate": len(hits) / len(seeds),
        "mean_steps_to_goal": float(np.mean(hits)) if hits else "",
        "plan_ms_median": milliseconds,
    }


def main() -> int:
    """Run missing cells and print the table."""
    options = tyro.cli(CostOptions, prog="python -m benchmarks.distance_as_cost")
    if options.episodes < 1:
        raise UserError(f"--episodes is {options.episodes}; it must be at least 1")
    env_name, path = tasks.canonical_name(options.env), RESULTS / "distance_as_cost.csv"
    torch.set_num_threads(1)
    for variant, settings in VARIANTS.items():
        needs_model = settings.get("cost") != "euclidean"
        for training_seed in options.training_seeds if needs_model else ("",):
            config = preset(env_name, seed=training_seed) if needs_model else None
            key = {
                "env": env_name, "variant": variant, "training_seed": training_seed,
                "training_hash": config.hash() if config else "",
                "planner_hash": plan_options(env_name, variant, None, options).hash() if settings else "",
                "samples": options.samples, "episodes": options.episodes, "seed": options.seed,
            }  # fmt: skip
            row = find(read_results(path), key)
            if row is None:
                checkpoint = trained(config) if config else None
                figures = run_cell(env_name, variant, checkpoint, options)
                append_result(path, {**key, **figures, "revision": git_revision()})
                row = find(read_results(path), key)
            assert row is not None
            rate, n = float(row["success_rate"]), options.episodes
            interval = describe(rate, wilson_interval(round(rate * n), n))
            steps = f"{float(row['mean_steps_to_goal']):.1f}" if row["mean_steps_to_goal"] else "-"
            print(f"{variant:32s} training seed {training_seed!s:>2s}  success {interval}  any "
                  f"{float(row['any_success_rate']):.2f}  steps {steps:>5s}  {float(row['plan_ms_median']):.0f} ms",
                  flush=True)  # fmt: skip
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
