"""Table of planning in real time: how few plans hold the control period, and what they still reach; markdown lines."""

from __future__ import annotations

from typing import Any

from benchmarks import policy_vs_mpc
from benchmarks import tables_planning as planning
from benchmarks.cells import read_results, shipped_training, training_of
from napsp.envs.cards import suite
from napsp.statistics import describe, wilson_interval


def realtime_rows() -> list[dict[str, Any]]:
    """Planned episodes of the models of plus that ship, as timed beside a period; first those with the policy's rollout."""
    found = []
    for env in suite("paper"):
        shipped = shipped_training(env, "_plus")
        rows = policy_vs_mpc.comparable(read_results(policy_vs_mpc.FILE))
        own = [row for row in rows if row["env"] == env and shipped and training_of(row) == shipped[0]]
        timed = [row for row in own if row["planner"] != "policy" and row.get("control_period_ms")]
        found += sorted(timed, key=lambda row: (row["proposals"] != "1", row["planner"], int(row["budget"])))
    return found


def realtime_table() -> list[str]:
    """Success and time per plan over budgets."""
    lines = [
        "### Planning in real time (`python -m benchmarks.policy_vs_mpc --env NAME --checkpoint NAME_plus --budgets 4 8 16`)",
        "",
        "*plus*, with the policy's rollout among the plans and without it, 50 fresh episodes; the median time of a plan call stands beside the control",
        "period, which it may take while the robot goes on. The simulation waited for every plan. A line for each budget that was tried.",
        "",
        "| task | policy's rollout among the samples | planner | budget | success | at goal in some step | ms per plan |",
        "|---|---|---|---|---|---|---|",
    ]
    rows = realtime_rows()
    for row in rows:
        n, rate = int(row["episodes"]), float(row["success_rate"])
        took, period = float(row["plan_ms_median"]), float(row["control_period_ms"])
        lines.append(
            f"| {row['env']} | {'yes' if row['proposals'] == '1' else 'no'} | {row['planner']} | {row['budget']} | {describe(rate, wilson_interval(round(rate * n), n))} "
            f"| {float(row['any_success_rate']):.2f} | {took:.0f} of {period:.0f}{planning.of_cores(row)} |"
        )
    missing = [env for env in suite("paper") if env not in {row["env"] for row in rows}]
    return lines + [f"| {env} | not run | | | | | |" for env in missing]
