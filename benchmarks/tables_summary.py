"""Table of what method plus comes to on each task, over training seeds; markdown lines."""

from __future__ import annotations

from typing import Any

from benchmarks.cells import usual_recipe
from benchmarks.curves import Line, current_runs
from benchmarks.tables_accuracy import accuracy_groups
from benchmarks.tables_glance import sparse_runs
from benchmarks.tables_planning import cost_rows, of_cores
from benchmarks.tables_plus import LAST, held
from benchmarks.tables_realtime import realtime_rows
from benchmarks.tables_training import first_at, over_seeds
from napsp.envs.cards import suite
from napsp.statistics import describe, interquartile_mean

TASKS = (*suite("paper"), "point_maze_long")
ALONG, AT_END = "mean", "end"
"""Where plans are charged, in the names of costs."""


def summary_table() -> list[str]:
    """A line for each task: how soon it is learned, how true d is, and what plans."""
    lines = [
        "### Method plus, task by task",
        "",
        f"*Held* is the mean of the last {LAST} evaluations, over training seeds its interquartile mean and 95 % bootstrap interval (three seeds or more), *worst*",
        "that of the worst seed; the long maze has six in all, so that its counts learning. Spearman and mean ratio: of d over exact steps in mazes, elsewhere over",
        "the fewest known ones, on the ways that need them. *d alone*: success in the last step of 50 fresh episodes for training seeds 0, 1 and 2 without the",
        "policy's rollout among the plans, which are charged along the way or at their end; MPPI with 64 samples, for boxes iCEM with 32, a rollout of the actions of least",
        "d among them. *In real time*: of the model that ships, with the policy's rollout. All of it has tables of its own below.",
        "",
        "| task | seeds | held | worst | 0.9 first at episode | Sparse + HER: 0.9 first | Spearman | mean ratio | d alone, along the plan | at its end | in real time |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    return lines + [f"| {env} | {' | '.join(_cells(env))} |" for env in TASKS]


def summary_rows() -> list[dict[str, Any]]:
    """What :func:`summary_table` is made of; training seeds under one name, those of episodes under theirs."""
    trained = [run for env in TASKS for run in (*plus_runs(env), *sparse_runs(env))]
    measured = [row for env in TASKS for row in accuracy_rows(env)]
    planned = [row for env in TASKS for where in (ALONG, AT_END) for row in alone_rows(env, where)]
    return [
        *({"revision": row["revision"], "training_seed": row["seed"], "seed": ""} for row in (*trained, *measured)),
        *planned,
        *(row for env in TASKS if (row := realtime_row(env))),
    ]


def plus_line(env: str) -> Line:
    """What runs of plus with today's settings are called."""
    return Line("plus", usual_recipe(env))


def plus_runs(env: str) -> list[dict[str, Any]]:
    """Published runs of plus."""
    return current_runs(env).get(plus_line(env), [])


def accuracy_rows(env: str) -> list[dict[str, str]]:
    """How true the distances of these are, those that were measured."""
    return accuracy_groups().get((env, plus_line(env).name), [])


def alone_rows(env: str, where: str) -> list[dict[str, Any]]:
    """Planned episodes with d alone, a row for each training seed."""
    boxes = "pick_place" in env
    prefix, plans = (
        (", iCEM of 32 plans", "greedy proposals instead of the policy's") if boxes else ("", "no policy proposals")
    )
    variant = f"plus{prefix}: distance, {where}, {plans}"
    asked = (env, variant, "", plus_line(env))
    rows = [row for row in cost_rows() if (row["env"], row["variant"], row["starts"], row["line"]) == asked]
    return sorted(rows, key=lambda row: int(row["training_seed"]))


def realtime_row(env: str) -> dict[str, Any] | None:
    """The most plans that keep pace, the policy's rollout among them."""
    own = [row for row in realtime_rows() if row["env"] == env and row["proposals"] == "1"]
    fast = [row for row in own if float(row["plan_ms_median"]) < float(row["control_period_ms"])]
    return max(fast, key=lambda row: int(row["budget"]), default=None)


def _cells(env: str) -> list[str]:
    """Cells of a line."""
    runs, sparse, measured, plans = plus_runs(env), sparse_runs(env), accuracy_rows(env), realtime_row(env)
    if not runs:
        return ["not run", *[""] * 9]
    successes = [held(run) for run in runs]
    cells = [str(len(runs)), describe(*interquartile_mean(successes)), f"{min(successes):.2f}", first_at(runs, 0.9)]
    cells.append(first_at(sparse, 0.9) if sparse else "not run")
    for name, digits in (("spearman", 3), ("mean_ratio", 2)):
        cells.append(over_seeds([float(row[name]) for row in measured], 3, digits) if measured else "not run")
    for where in (ALONG, AT_END):
        rates = ", ".join(f"{float(row['success_rate']):.2f}" for row in alone_rows(env, where))
        cells.append(rates or "not run")
    if plans is None:
        return [*cells, "not run"]
    took = f"{float(plans['plan_ms_median']):.0f} of {float(plans['control_period_ms']):.0f} ms{of_cores(plans)}"
    return [*cells, f"{plans['budget']} plans, {took}: {float(plans['success_rate']):.2f}"]
