"""Tables of what ships: what the straight line, policies, distances alone and planners come to; markdown lines."""

from __future__ import annotations

from typing import Any

from benchmarks import policy_vs_mpc
from benchmarks.cells import read_results, shipped_training, training_of, usual_recipe
from benchmarks.curves import Line, current_runs
from benchmarks.tables_planning import HALF_TRAINED, cost_rows, success
from benchmarks.tables_training import summary
from napsp.envs.cards import suite
from napsp.statistics import paired_proportions

OURS, PLUS = "", "_plus"
"""How the name of a model that ships ends, behind its task's."""


def glance_table() -> list[str]:
    """A line for each task of the paper."""
    columns = [f"{method}: {column}" for method in ("ours", "plus") for column in ("policy", "d alone", "planner")]
    seeds = [len(runs) for env in suite("paper") if (runs := sparse_runs(env))] or [0]
    lines = [
        "### At a glance",
        "",
        "Success in the last step of 50 fresh episodes, 95 % Wilson interval, of the checkpoints that ship (`TASK`, `TASK_plus`), one training",
        "run each. *Planner*: MPPI, for pick and place iCEM, with the learned distance, 64 plans per control step, the policy's rollout among",
        "them; *d alone*: without that rollout; *straight line*: MPPI with that cost and noise of one size, on 50 other episodes. *Sparse + HER*:",
        f"its policy's last evaluation, interquartile mean and bootstrap interval over {min(seeds)} to {max(seeds)} training seeds. Episodes of training, and what",
        "differs from today's settings: [checkpoints that ship](docs/results.md#checkpoints-that-ship-planned).",
        "",
        f"| task | straight line | Sparse + HER | {' | '.join(columns)} |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for env in suite("paper"):
        straight, sparse = _straight(env), sparse_runs(env)
        cells = [success(straight) if straight else "not run"]
        cells.append(summary([run["curve"][-1] for run in sparse], "success_rate") if sparse else "not run")
        for variant in (OURS, PLUS):
            rows = _planned(env, variant)
            cells += [success(rows[name]) if name in rows else "not run" for name in ("policy", "d alone", "planner")]
        lines.append(f"| {env} | {' | '.join(cells)} |")
    if HALF_TRAINED.is_file():
        lines += [
            "",
            "A half-trained d plans long before its policy works (right):",
            "",
        ]
        lines += [f"![Success of policy and planners on point_maze over budgets and training episodes]({HALF_TRAINED})"]
    return lines


def glance_rows() -> list[dict[str, Any]]:
    """What :func:`glance_table` is made of; of the runs of Sparse + HER their revisions and training seeds."""
    straight = [row for env in suite("paper") if (row := _straight(env))]
    runs = [run for env in suite("paper") for run in sparse_runs(env)]
    return [
        *planned_rows(),
        *straight,
        *({"revision": run["revision"], "training_seed": run["seed"], "seed": ""} for run in runs),
    ]


def planned_table() -> list[str]:
    """A line for every model that ships by its task's name."""
    lines = [
        "### Checkpoints that ship, planned",
        "",
        "Success in the last step of 50 fresh episodes, 95 % Wilson interval, of policy, planner (64 plans per control step, the policy's rollout",
        "among them) and planner without that rollout (`python -m benchmarks.policy_vs_mpc --env NAME --checkpoint NAME_plus`). *Planner minus",
        "policy*: on the same episodes, Newcombe's paired interval. *Steps to goal*: over episodes that got there.",
        "",
        "| task | training | policy | d alone | planner | planner minus policy | steps to goal, policy / planner |",
        "|---|---|---|---|---|---|---|",
    ]
    return lines + [
        f"| {env} | {' | '.join(_cells(env, variant))} |" for env in suite("paper") for variant in (OURS, PLUS)
    ]


def planned_rows() -> list[dict[str, Any]]:
    """The rows of :func:`planned_table`."""
    return [row for env in suite("paper") for variant in (OURS, PLUS) for row in _planned(env, variant).values()]


def sparse_runs(env: str) -> list[dict[str, Any]]:
    """Published runs of Sparse + HER with the settings that a task is compared by."""
    return current_runs(env).get(Line("sparse", usual_recipe(env)), [])


def _straight(env: str) -> dict[str, Any] | None:
    """The row of the straight line as a cost."""
    wanted = (env, "euclidean, mean along the plan", "")
    return next((row for row in reversed(cost_rows()) if (row["env"], row["variant"], row["starts"]) == wanted), None)


def _planned(env: str, variant: str) -> dict[str, dict[str, Any]]:
    """Rows of a model that ships for a task, by column; those that were run."""
    planner, shipped = "icem" if "pick_place" in env else "mppi", shipped_training(env, variant)
    found: dict[tuple[str, str], dict[str, str]] = {}
    for row in policy_vs_mpc.comparable(read_results(policy_vs_mpc.FILE)):
        if row["env"] == env and shipped and training_of(row) == shipped[0] and row["budget"] in ("0", "64"):
            found[row["planner"], row["proposals"]] = row
    columns = {"policy": ("policy", "0"), "planner": (planner, "1"), "d alone": (planner, "0")}
    return {column: found[cell] for column, cell in columns.items() if cell in found}


def _cells(env: str, variant: str) -> list[str]:
    """Cells of a line of :func:`planned_table`."""
    rows = _planned(env, variant)
    policy, plans, alone = (rows.get(column) for column in ("policy", "planner", "d alone"))
    if policy is None:
        return [f"{'plus' if variant == PLUS else 'ours'}, not run", "", "", "", "", ""]
    cells = [f"{policy['line'].name}, {policy['training_episodes']} episodes", success(policy)]
    cells.append(success(alone) if alone else "not run")
    steps = [f"{float(row['mean_steps_to_goal'] or 'nan'):.1f}" if row else "-" for row in (policy, plans)]
    steps_to_goal = " / ".join(steps).replace("nan", "-")
    if plans is None:
        return [*cells, "not run", "", steps_to_goal]
    gain, (low, high) = paired_proportions(*([float(hit) for hit in row["successes"]] for row in (plans, policy)))
    difference = f"{gain:+.2f} [{low:+.2f}, {high:+.2f}]"
    return [*cells, f"{success(plans)} {plans['planner']}", difference, steps_to_goal]
