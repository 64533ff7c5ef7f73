"""Run a trained policy: ``python -m napsp.evaluate --env fetch_wall``."""

from __future__ import annotations

import sys
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch

from napsp import envs as tasks
from napsp.callable_module import callable_module
from napsp.command_line import ask
from napsp.config import DEFAULT
from napsp.data.outcomes import evaluate
from napsp.envs.gap import goal_gap
from napsp.envs.goal_task import make_goal_task
from napsp.errors import UserError, run_command
from napsp.policy.greedy import GreedyPolicy
from napsp.settings import FIRST_SEED
from napsp.statistics import describe, wilson_interval
from napsp.storage.checkpoint import load_model
from napsp.storage.files import write_json
from napsp.storage.shipped import shipped_model


@dataclass(frozen=True)
class EvaluateOptions:
    """Run the deterministic policy of a checkpoint."""

    env: str | None = None
    """Task: one that napsp list shows, or what --checkpoint was trained on, which is the default; without either,
    fetch_wall."""
    checkpoint: Path | None = None
    """A file or folder written by napsp.train, or the name of one that ships, such as
    fetch_pick_place_first_arrival; default: the one that ships for the task."""
    episodes: int = 50
    """Episodes, on the seeds seed, seed + 1, ..."""
    seed: int = FIRST_SEED
    """First seed; by default the episodes that planning commands begin with."""
    out: Path | None = None
    """JSON file for the figures."""


def main() -> int:
    """Evaluate, print, optionally write JSON."""
    options = ask(EvaluateOptions, sys.argv[1:], "python -m napsp.evaluate", [f.name for f in fields(EvaluateOptions)])
    if options.episodes < 1 or options.seed < 0:
        raise UserError("--episodes must be at least 1 and --seed at least 0")
    torch.set_num_threads(1)
    asked = tasks.canonical_name(options.env or DEFAULT.env) if options.env or not options.checkpoint else None
    model = load_model(options.checkpoint or shipped_model(asked or DEFAULT.env), asked)
    env_name = model.config.env
    env = make_goal_task(env_name, model.config.reached)
    model.check_sizes(env)
    seeds = [options.seed + i for i in range(options.episodes)]
    result, _ = evaluate([env], GreedyPolicy(model.policy), seeds, model.config.episode_length)
    shown, unit = goal_gap(env.unwrapped, result.gaps[:, -1])
    env.close()
    hits = result.first_hits[~np.isnan(result.first_hits)]
    n = len(seeds)
    figures = {
        "env": env_name,
        "planner": "policy",
        "episodes": n,
        "seed": options.seed,
        "success_rate": result.success_rate,
        "success_interval_95": wilson_interval(int(result.reached[:, -1].sum()), n),
        "any_success_rate": result.any_success_rate,
        "any_success_interval_95": wilson_interval(len(hits), n),
        "mean_steps_to_goal": float(hits.mean()) if len(hits) else None,
        f"mean_final_gap_{unit}".rstrip("_"): float(shown.mean()),
        "checkpoint": model.header,
    }
    print(f"policy on {env_name}: success {describe(figures['success_rate'], figures['success_interval_95'])}, "
          f"at goal in some step {describe(figures['any_success_rate'], figures['any_success_interval_95'])}, "
          f"steps to goal {'-' if not len(hits) else f'{hits.mean():.1f}'}")  # fmt: skip
    if options.out is not None:
        write_json(options.out, figures)
    return 0


callable_module(__name__, "evaluate")

if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
