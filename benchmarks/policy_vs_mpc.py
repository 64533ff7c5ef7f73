"""Policy against planner with the same learned distance: ``python -m benchmarks.policy_vs_mpc --env fetch_wall``.

The policy alone, and every planner with that policy's d as its cost, with and without the policy's
rollout among its samples, for several budgets - all on the same fresh episodes. ``--progress`` asks
the same of checkpoints from early in training: a planner can use a distance long before the
policy that learns from it works. Cells that are already in ``results/`` are not run again.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.cells import (
    RESULTS,
    add_result,
    as_text,
    figures_folder,
    find,
    read_results,
    shipped_training,
    training_of,
    usual_recipe,
)
from benchmarks.command import read_options
from benchmarks.curves import Line, is_current, line_of
from benchmarks.planned import COLUMN, column, of_budget
from benchmarks.subjects import Subject
from benchmarks.versus_figure import PLANNERS, SMOOTHING, draw
from mpc.motion import action_rate
from mpc.rollout import available_cores
from napsp import envs as tasks
from napsp.config import preset
from napsp.data.outcomes import evaluate
from napsp.errors import UserError, run_command
from napsp.policy.greedy import GreedyPolicy
from napsp.settings import FIRST_SEED
from napsp.statistics import describe, paired_proportions, wilson_interval
from napsp.storage.checkpoint import load_model
from napsp.storage.revision import git_revision
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session

FILE = RESULTS / "policy_vs_mpc.csv"


@dataclass(frozen=True)
class VersusOptions:
    """Compare the policy with planners that use the same distance."""

    env: str = "fetch_wall"
    """Task."""
    planners: tuple[str, ...] = PLANNERS
    """Search algorithms; none for the policy alone."""
    budgets: tuple[int, ...] = (64,)
    """Simulated plans per control step, over all refinements."""
    proposals: tuple[bool, ...] = (True, False)
    """With and without the policy's rollout among the samples."""
    smoothing: bool = True
    """Also the first planner with the smoothing layer, at every budget."""
    checkpoint: Path | None = None
    """Model file or folder of a finished run, or the name of one that ships, in place of those that the following
    options describe."""
    recipe: str | None = None
    """Recipe of the checkpoint, see napsp.train; default manipulation for pick and place, paper for all others."""
    training_seed: int = 0
    """Training seed of the checkpoint, which is trained first if it does not exist."""
    training_episodes: int | None = None
    """Training episodes of the checkpoint; default the task's preset."""
    first_arrival: bool = False
    """Train the checkpoint with labels of first arrival, see napsp.train."""
    episodes_per_iteration: int | None = None
    """Training episodes per iteration of the checkpoint; default the task's preset."""
    progress: tuple[int, ...] = ()
    """Also checkpoints of runs that stop after these many training episodes."""
    episodes: int = 50
    """Episodes per cell."""
    seed: int = FIRST_SEED
    """First episode seed; these seeds were never used for tuning."""


def plan_config(env: str, planner: str, budget: int, proposals: bool) -> PlanConfig[Any] | None:
    """A planner that simulates ``budget`` plans per control step; None for the policy alone."""
    if not budget:
        return None
    name, smooth, _ = planner.partition(SMOOTHING)
    return of_budget(name, budget, {"env": env, "proposals": proposals, "smooth": bool(smooth)})


def run_policy(env_name: str, checkpoint: Path, seeds: list[int]) -> dict[str, Any]:
    """The policy alone on every seed."""
    model, env = load_model(checkpoint, env_name), tasks.make(env_name)
    result, episodes = evaluate([env], GreedyPolicy(model.policy), seeds, model.config.episode_length)
    hits = [None if np.isnan(hit) else int(hit) for hit in result.first_hits]
    return _figures(result.reached[:, -1].tolist(), hits, 0.0, [action_rate(actions) for actions in episodes.actions])


def run_planner(config: PlanConfig[Any], checkpoint: Path, seeds: list[int]) -> dict[str, Any]:
    """A planner on every seed."""
    session = Session.open(config, RunOptions(seed=seeds[0], checkpoint=checkpoint))
    results = [session.run_episode(seed) for seed in seeds]
    session.close()
    milliseconds = float(np.median(np.concatenate([result.plan_ms for result in results])))
    rates, period = [result.action_rate for result in results], session.control_period
    figures = _figures([r.success for r in results], [r.first_hit for r in results], milliseconds, rates)
    return {**figures, "control_period_ms": "" if period is None else round(1e3 * period, 3)}


def _figures(
    success: list[bool], hits: list[int | None], milliseconds: float, action_rates: list[float]
) -> dict[str, Any]:
    found = [hit for hit in hits if hit is not None]
    return {
        "success_rate": float(np.mean(success)),
        "any_success_rate": len(found) / len(hits),
        "mean_steps_to_goal": float(np.mean(found)) if found else "",
        "plan_ms_median": milliseconds,
        "action_rate": float(np.mean(action_rates)),
        "successes": "".join(str(int(s)) for s in success),
        "first_hits": " ".join("-" if hit is None else str(hit) for hit in hits),
    }


def subjects(options: VersusOptions) -> list[Subject]:
    """Models to compare with."""
    env = tasks.canonical_name(options.env)
    if options.checkpoint is not None:
        usual = VersusOptions()
        described = (
            "recipe",
            "training_seed",
            "training_episodes",
            "first_arrival",
            "episodes_per_iteration",
            "progress",
        )
        for name in (name for name in described if getattr(options, name) != getattr(usual, name)):
            raise UserError(f"--{name.replace('_', '-')} describes a checkpoint to train; leave out it or --checkpoint")
        return [Subject.existing(env, options.checkpoint)]
    changes: dict[str, Any] = {"temporal.first_arrival": True} if options.first_arrival else {}
    if options.episodes_per_iteration is not None:
        changes["episodes_per_iteration"] = options.episodes_per_iteration
    recipe, found = options.recipe or usual_recipe(env), []
    for n_episodes in (options.training_episodes, *options.progress):
        length = {} if n_episodes is None else {"n_episodes": n_episodes}
        config = preset(env, "ours", recipe, {**changes, **length}, seed=options.training_seed)
        found.append(Subject.of(config))
    return found


def cells(options: VersusOptions) -> list[tuple[Subject, str, int, bool]]:
    """Model, planner ("policy" for none), budget, proposals."""
    found = []
    for subject in subjects(options):
        found.append((subject, "policy", 0, False))
        for planner in options.planners:
            for budget in options.budgets:
                found += [(subject, planner, budget, proposals) for proposals in options.proposals]
        if options.smoothing and options.planners:
            name = options.planners[0] + SMOOTHING
            found += [(subject, name, budget, p) for budget in options.budgets for p in options.proposals]
    return found


def run_cell(subject: Subject, planner: str, budget: int, proposals: bool, options: VersusOptions) -> dict[str, str]:
    """The row of a cell; run if it is not there yet."""
    planned = plan_config(subject.env, planner, budget, proposals)
    key = {
        "env": subject.env, "planner": planner, "budget": budget, "proposals": int(proposals),
        "training_seed": subject.seed, "training_episodes": subject.n_episodes, "training": as_text(subject.training),
        COLUMN: column(planned), "episodes": options.episodes, "seed": options.seed,
    }  # fmt: skip
    row = find(read_results(FILE), key)
    if row is None:
        checkpoint, seeds = subject.checkpoint(), [options.seed + i for i in range(options.episodes)]
        if planned is None:
            figures = run_policy(subject.env, checkpoint, seeds)
        else:
            figures = run_planner(planned, checkpoint, seeds)
        add_result(FILE, key, {**figures, "revision": git_revision(), "cores": available_cores()})
        row = find(read_results(FILE), key)
    assert row is not None
    return dict(row)


@cache  # tables compare every row with it
def _column_of_today(env: str, planner: str, budget: int, proposals: bool) -> str:
    return column(plan_config(env, planner, budget, proposals))


def usual_seed(training: Mapping[str, Any]) -> int:
    """Training seed of the model that ships with this training; 0 if none does."""
    ships = [shipped_training(training["env"], variant) for variant in ("", "_plus")]
    return next((shipped[1] for shipped in ships if shipped and shipped[0] == training), 0)


def comparable(
    rows: Iterable[dict[str, str]], episodes: int = 50, seed: int = 90_000, training_seed: int | None = None
) -> list[dict[str, Any]]:
    """Rows of the same episodes whose planner is today's, with the ``line`` that their training belongs to.

    Those of a training are of one training seed, for a line through several would mix policies: ``training_seed``, or
    that of the model that ships.
    """
    found: list[tuple[Line, dict[str, Any]]] = []
    for row in rows:
        training = training_of(row) or {}
        line = line_of(training)
        if line is None:
            continue
        of_line = usual_seed(training) if training_seed is None else training_seed
        if (row["episodes"], row["seed"], row["training_seed"]) != (str(episodes), str(seed), str(of_line)):
            continue
        budget, proposals = int(row["budget"]), row["proposals"] == "1"
        if row[COLUMN] == _column_of_today(row["env"], row["planner"], budget, proposals):
            found.append((line, row))
    measured = {(row["env"], line) for line, row in found}
    return [
        {**row, "line": line}
        for line, row in found
        if is_current(line, [other for env, other in measured if env == row["env"]])
    ]


def main() -> int:
    """Run missing cells, print the table, draw the figure."""
    options = read_options(VersusOptions, "policy_vs_mpc", may_be_empty=("planners",), budgets=1)
    unknown = set(options.planners) - set(PLANNERS)
    if unknown:
        raise UserError(f"unknown planner {unknown.pop()!r}; choose from: {', '.join(PLANNERS)}")
    torch.set_num_threads(1)
    policy: dict[int, str] = {}
    todo = cells(options)
    for subject, planner, budget, proposals in todo:
        plan_config(subject.env, planner, budget, proposals)  # too small? better said before hours of work
    for subject, planner, budget, proposals in todo:
        row = run_cell(subject, planner, budget, proposals, options)
        n, successes = len(row["successes"]), row["successes"]
        policy.setdefault(subject.n_episodes, successes)
        interval = describe(float(row["success_rate"]), wilson_interval(successes.count("1"), n))
        mean, (low, high) = paired_proportions(_bits(successes), _bits(policy[subject.n_episodes]))
        name = f"{planner}{' + policy' if proposals else ''}"
        line = line_of(subject.training)
        training = f"{line.name if line else 'other settings'}, {subject.n_episodes} episodes"
        print(f"{subject.env}: {training}  {name:30s} {budget:5d} plans  success {interval}  "
              f"minus policy {mean:+.2f} [{low:+.2f}, {high:+.2f}]  {float(row['plan_ms_median']):.0f} ms",
              flush=True)  # fmt: skip
    own = [row for row in read_results(FILE) if row["env"] == todo[0][0].env]
    measured = todo[0][0]
    of_line = None if measured.seed == usual_seed(measured.training) else measured.seed
    picture = draw(comparable(own, options.episodes, options.seed, of_line), figures_folder(options))
    if picture is not None:
        print(f"picture: {picture}")
    return 0


def _bits(text: str) -> list[float]:
    return [float(character) for character in text]


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
