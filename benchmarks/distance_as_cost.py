"""Which cost plans? ``python -m benchmarks.distance_as_cost --env fetch_wall``.

MPPI (iCEM where a line says so) with the learned distance (along the plan, at its end, both), with
the distances of the other methods, with the straight line, with nothing but the goal's radius and, in
mazes, with true shortest paths, beside the policy alone: on the same episodes, for checkpoints of
several training seeds. Cells that are already in ``results/distance_as_cost.csv`` are not run again.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.cells import (
    RESULTS,
    add_result,
    as_text,
    checkpoint_of,
    find,
    read_results,
    training_of,
    usual_recipe,
)
from benchmarks.command import read_options
from benchmarks.curves import Line, full_line_of, is_current
from benchmarks.planned import COLUMN, column, of_budget
from napsp import envs as tasks
from napsp.config import preset
from napsp.data.collect import roll
from napsp.data.episodes import concatenate
from napsp.data.outcomes import outcomes
from napsp.errors import UserError, run_command
from napsp.policy.greedy import GreedyPolicy
from napsp.policy.greedy_distance import GreedyDistance
from napsp.statistics import describe, wilson_interval
from napsp.storage.checkpoint import Model, load_model
from napsp.storage.revision import git_revision
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session


@dataclass(frozen=True)
class Variant:
    """One line of the comparison: the checkpoint's method (None: no checkpoint) and what the planner has otherwise."""

    method: str | None
    planner: dict[str, Any] | None
    """None: the policy alone, or what d alone would do."""
    search: str = "mppi"
    plans: int | None = None
    """Simulated plans per control step; None is the number that the options give."""
    greedy: bool = False
    """Without a planner: the action of least d, not the policy's."""


DISTANCE = {"cost": "distance", "where": "mean"}
ONE_SIZE, SHRINKING = {"search.finest": 1.0}, {"search.finest": 0.1}
"""MPPI's noise, whatever the task's own: of plus it shrinks from sample to sample, of the others it is of one size."""
GREEDY = {"proposals": False, "distance.greedy_proposals": True}
VARIANTS: dict[str, Variant] = {
    "distance, mean along the plan": Variant("ours", DISTANCE),
    "euclidean, mean along the plan": Variant(None, {"cost": "euclidean", "where": "mean"}),
    "policy alone": Variant("ours", None),
    "the action of least d, no plans": Variant("ours", None, greedy=True),
    "distance, end of the plan": Variant("ours", {"cost": "distance", "where": "terminal"}),
    "distance, mean and end": Variant("ours", {"cost": "distance", "where": "both"}),
    "distance, mean, no policy proposals": Variant("ours", {**DISTANCE, "proposals": False}),
    "distance, mean, greedy proposals instead of the policy's": Variant("ours", {**DISTANCE, **GREEDY}),
    "distance, end, no policy proposals": Variant(
        "ours", {"cost": "distance", "where": "terminal", "proposals": False}
    ),
    "off-policy DDL distance, mean": Variant("offpolicy_ddl", DISTANCE),
    "off-policy DDL distance, mean, no policy proposals": Variant("offpolicy_ddl", {**DISTANCE, "proposals": False}),
    "DDL distance, mean": Variant("ddl", DISTANCE),
    "DDL distance, mean, no policy proposals": Variant("ddl", {**DISTANCE, "proposals": False}),
    "plus: policy alone": Variant("plus", None),
    "plus: the action of least d, no plans": Variant("plus", None, greedy=True),
    "plus: distance, mean": Variant("plus", {**DISTANCE, **SHRINKING}),
    "plus: distance, mean, no policy proposals": Variant("plus", {**DISTANCE, **SHRINKING, "proposals": False}),
    "plus: distance, end, no policy proposals": Variant(
        "plus", {"cost": "distance", "where": "terminal", **SHRINKING, "proposals": False}
    ),
    "plus, iCEM of 32 plans: distance, mean, no policy proposals": Variant(
        "plus", {**DISTANCE, "proposals": False}, "icem", 32
    ),
    "plus, iCEM of 32 plans: distance, end, no policy proposals": Variant(
        "plus", {"cost": "distance", "where": "terminal", "proposals": False}, "icem", 32
    ),
    "plus, iCEM of 32 plans: distance, mean, greedy proposals instead of the policy's": Variant(
        "plus", {**DISTANCE, **GREEDY}, "icem", 32
    ),
    "plus, iCEM of 32 plans: distance, end, greedy proposals instead of the policy's": Variant(
        "plus", {"cost": "distance", "where": "terminal", **GREEDY}, "icem", 32
    ),
    "sparse": Variant(None, {"cost": "sparse"}),
    "shortest path, mean along the plan": Variant(None, {"cost": "shortest_path", "where": "mean"}),
    "shortest path, mean, noise down to a tenth": Variant(
        None, {"cost": "shortest_path", "where": "mean", **SHRINKING}
    ),
    "shortest path, mean, predictive sampling, noise down to a tenth": Variant(
        None, {"cost": "shortest_path", "where": "mean", **SHRINKING}, "predictive_sampling"
    ),
    "shortest path, mean, CEM": Variant(None, {"cost": "shortest_path", "where": "mean"}, "cem"),
    "shortest path, mean, iCEM": Variant(None, {"cost": "shortest_path", "where": "mean"}, "icem"),
}


@dataclass(frozen=True)
class CostOptions:
    """Compare costs for planning on one task."""

    env: str = "fetch_wall"
    """Task."""
    training_seeds: tuple[int, ...] = (0, 1, 2)
    """Checkpoints of these training seeds; missing ones are trained first."""
    training_episodes: int | None = None
    """Training episodes of the checkpoints; default the task's preset."""
    recipe: str | None = None
    """Recipe of the checkpoints, see napsp.train; default manipulation for pick and place, paper for all others."""
    episodes: int = 50
    """Episodes per cell."""
    seed: int = 80_000
    """First episode seed; these seeds were never used for tuning."""
    samples: int = 64
    """Plans per control step, of lines that have no number of their own."""
    variants: tuple[str, ...] = ()
    """Which lines; default all that the task has."""
    anywhere: bool = False
    """Mazes: start and goal from all rooms alike, not the task's own."""

    @property
    def starts(self) -> str:
        """Column of a row: empty for the task's own starts and goals."""
        return "anywhere" if self.anywhere else ""


def plan_episodes(
    session: Session, seeds: list[int], reset: dict[str, Any] | None = None
) -> tuple[list[bool], list[int], float]:
    """Success per episode, first hits, and median milliseconds per plan."""
    results = [session.run_episode(seed, options=reset) for seed in seeds]
    hits = [r.first_hit for r in results if r.first_hit is not None]
    return [r.success for r in results], hits, float(np.median(np.concatenate([r.plan_ms for r in results])))


def plans_of(variant: str, options: CostOptions) -> int:
    """Simulated plans per control step of a line."""
    return VARIANTS[variant].plans or options.samples


def search_of(variant: str) -> str:
    """Column of a row: name of the search, empty for the policy alone."""
    return VARIANTS[variant].search if VARIANTS[variant].planner is not None else ""


def plan_config(env_name: str, variant: str, options: CostOptions) -> PlanConfig[Any] | None:
    """The planner of a cell; None for the policy alone."""
    line = VARIANTS[variant]
    if line.planner is None:
        return None
    noise = ONE_SIZE if line.search == "mppi" else {}
    return of_budget(line.search, plans_of(variant, options), {"env": env_name, **noise, **line.planner})


def run_cell(env_name: str, variant: str, checkpoint: Path | None, options: CostOptions) -> dict[str, Any]:
    """Run one cell of the table."""
    seeds, config = [options.seed + i for i in range(options.episodes)], plan_config(env_name, variant, options)
    reset = {"anywhere": True} if options.anywhere else None
    if config is None:
        assert checkpoint is not None
        model, env = load_model(checkpoint, env_name), tasks.make(env_name)
        act = GreedyPolicy(model.policy) if not VARIANTS[variant].greedy else greedy_distance(model)
        parts = [roll([env], act, [s], model.config.episode_length, [reset]) for s in seeds]
        result = outcomes(env, concatenate(parts))
        success, hits = result.reached[:, -1].tolist(), result.first_hits[~np.isnan(result.first_hits)].tolist()
        milliseconds = 0.0
    else:
        session = Session.open(config, RunOptions(seed=options.seed, checkpoint=checkpoint))
        success, hits, milliseconds = plan_episodes(session, seeds, reset)
        session.close()
    return {
        "success_rate": float(np.mean(success)),
        "any_success_rate": len(hits) / len(seeds),
        "mean_steps_to_goal": float(np.mean(hits)) if hits else "",
        "plan_ms_median": milliseconds,
    }


def greedy_distance(model: Model) -> GreedyDistance:
    """What follows d downhill, without plans."""
    assert model.distance is not None
    return GreedyDistance(model.distance, model.header["sizes"][1])


def rows_of(path: Path, options: CostOptions) -> list[dict[str, str]]:
    """Rows with these starts; the oldest ones do not say that theirs are the task's own."""
    return [row for row in read_results(path) if row.get("starts", "") == options.starts]


def comparable(rows: Iterable[dict[str, str]]) -> list[dict[str, Any]]:
    """Rows of the default episodes and samples whose planner is today's, with the ``line`` of their training.

    That is the variant's method as the task is compared by, or an older version of it while today's has no row; None
    where no model is asked.
    """
    found: list[tuple[Line | None, dict[str, str]]] = []
    for row in ({"starts": "", **row} for row in rows):
        variant, options = VARIANTS.get(row["variant"]), CostOptions(env=row["env"])
        if variant is None:
            continue
        sizes = (search_of(row["variant"]), column(plan_config(row["env"], row["variant"], options)),
                 str(plans_of(row["variant"], options)), str(options.episodes), str(options.seed))  # fmt: skip
        if tuple(row[n] for n in ("planner", COLUMN, "samples", "episodes", "seed")) != sizes:
            continue
        training = training_of(row)
        line = full_line_of(training) if training else None
        wanted = Line(variant.method, usual_recipe(row["env"])) if variant.method else None
        if (line.of_today() if line else None) == wanted and bool(training) == bool(wanted):
            found.append((line, row))
    measured = {(row["env"], row["variant"] + row["starts"], line) for line, row in found}
    return [
        {**row, "line": line}
        for line, row in found
        if line is None
        or is_current(line, [m[2] for m in measured if m[2] and m[:2] == (row["env"], row["variant"] + row["starts"])])
    ]


def main() -> int:
    """Run missing cells and print the table."""
    options = read_options(CostOptions, "distance_as_cost")
    env_name, path = tasks.canonical_name(options.env), RESULTS / "distance_as_cost.csv"
    torch.set_num_threads(1)
    unknown = set(options.variants) - set(VARIANTS)
    if unknown:
        raise UserError(f"unknown variant {unknown.pop()!r}; choose from: {'; '.join(VARIANTS)}")
    length = {"n_episodes": options.training_episodes} if options.training_episodes is not None else {}
    recipe = options.recipe or usual_recipe(env_name)
    is_maze = hasattr(tasks.make(env_name).unwrapped, "shortest_steps")
    if options.anywhere and not is_maze:
        raise UserError(f"--anywhere is for mazes; {env_name} has its own starts and goals")
    for variant in options.variants or [name for name in VARIANTS if is_maze or "shortest" not in name]:
        method = VARIANTS[variant].method
        for training_seed in options.training_seeds if method else ("",):
            config = preset(env_name, method, recipe, length, seed=training_seed) if method else None
            key = {
                "env": env_name, "variant": variant, "training_seed": training_seed,
                "training": as_text(config.identity() if config else None),
                "planner": search_of(variant),
                COLUMN: column(plan_config(env_name, variant, options)),
                "samples": plans_of(variant, options), "episodes": options.episodes, "seed": options.seed,
            }  # fmt: skip
            row = find(rows_of(path, options), key)
            if row is None:
                checkpoint = checkpoint_of(config) if config else None
                figures = run_cell(env_name, variant, checkpoint, options)
                add_result(path, key | {"starts": options.starts}, figures | {"revision": git_revision()})
                row = find(rows_of(path, options), key)
            assert row is not None
            rate, n = float(row["success_rate"]), options.episodes
            interval = describe(rate, wilson_interval(round(rate * n), n))
            steps = f"{float(row['mean_steps_to_goal']):.1f}" if row["mean_steps_to_goal"] else "-"
            print(f"{variant:80s} training seed {training_seed!s:>2s}  success {interval}  any "
                  f"{float(row['any_success_rate']):.2f}  steps {steps:>5s}  {float(row['plan_ms_median']):.0f} ms",
                  flush=True)  # fmt: skip
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
