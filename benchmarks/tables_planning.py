"""Tables of planning: costs, policy against planner, smoothing; each a list of markdown lines."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

from benchmarks import distance_as_cost, policy_vs_mpc, smoothing
from benchmarks.cells import RESULTS, read_results
from napsp.envs.cards import suite
from napsp.statistics import describe, wilson_interval

HALF_TRAINED = RESULTS / "policy_vs_mpc_point_maze.png"


def success(row: dict[str, str]) -> str:
    """Success of planned episodes with its interval."""
    n, rate = int(row["episodes"]), float(row["success_rate"])
    return describe(rate, wilson_interval(round(rate * n), n))


def _by_task(env: str) -> tuple[int, str]:
    """Sorting key: the paper's tasks in its order, then others."""
    return suite("paper").index(env) if env in suite("paper") else len(suite("paper")), env


def cost_rows() -> list[dict[str, Any]]:
    """What :func:`cost_table` pools."""
    return distance_as_cost.comparable(read_results(RESULTS / "distance_as_cost.csv"))


def cost_table() -> list[str]:
    """Costs for planning, pooled over training seeds."""
    groups: dict[tuple[str, str, str], list[dict[str, str]]] = defaultdict(list)
    for row in cost_rows():
        variant = row["variant"] + (", uniform starts and goals" if row["starts"] else "")
        groups[row["env"], variant, row["line"].name if row["line"] else "-"].append(row)
    for rows in groups.values():
        rows.sort(key=lambda row: int(row["training_seed"] or 0))
    lines = [
        "### Which cost plans (`python -m benchmarks.distance_as_cost --env NAME`)",
        "",
        "MPPI with 64 samples, noise of one size (of plus: shrinking from sample to sample), or iCEM with 32 where the line says so; fresh episode seeds, success in the last step with its 95 % Wilson interval over all episodes;",
        "episodes of one checkpoint share its training, so read the rates per training seed as well.",
        "",
        "| task | cost | training | success | per training seed | at goal in some step | steps to goal |",
        "|---|---|---|---|---|---|---|",
    ]
    for (env, variant, training), rows in sorted(groups.items(), key=lambda group: _by_task(group[0][0])):
        n = sum(int(row["episodes"]) for row in rows)
        successes = sum(round(float(row["success_rate"]) * int(row["episodes"])) for row in rows)
        any_rate = sum(float(row["any_success_rate"]) for row in rows) / len(rows)
        hits = [float(row["any_success_rate"]) * int(row["episodes"]) for row in rows]
        arrived = [(n_hits, row["mean_steps_to_goal"]) for n_hits, row in zip(hits, rows, strict=True) if n_hits]
        steps = sum(n_hits * float(mean) for n_hits, mean in arrived) / sum(hits) if arrived else None
        seeds = ", ".join(f"{float(row['success_rate']):.2f}" for row in rows) if rows[0]["training_seed"] else "-"
        lines.append(
            f"| {env} | {variant} | {training} | {describe(successes / n, wilson_interval(successes, n))} | {seeds} | {any_rate:.2f} "
            f"| {'-' if steps is None else f'{steps:.1f}'} |"
        )
    return lines


def of_cores(row: dict[str, str]) -> str:
    """How many cores a time was taken on, where it was not two."""
    cores = row.get("cores") or "2"
    return "" if cores == "2" else f" ({cores} core{'s' if cores != '1' else ''})"


def versus_rows() -> list[dict[str, Any]]:
    """What :func:`versus_table` shows."""
    return policy_vs_mpc.comparable(read_results(policy_vs_mpc.FILE))


def versus_table() -> list[str]:
    """The policy against planners with the same distance."""
    rows = versus_rows()
    rows.sort(key=lambda row: (*_by_task(row["env"]), -int(row["training_episodes"]), row["line"].name))
    lines = [
        "### Policy against planner (`python -m benchmarks.policy_vs_mpc --env NAME`)",
        "",
        "The same distance, the same fresh episodes; *budget* is simulated plans per control step over all refinements (iCEM 62, CEM 63 of",
        "64; the smoothing layer verifies 25 to 40 more, which are not counted). Times are of two cores unless others are named, some of them with other work beside.",
        "",
        "| task | training | episodes | planner | policy's rollout among the samples | budget | success | steps to goal | action rate | ms per plan |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        policy = row["planner"] == "policy"
        steps = f"{float(row['mean_steps_to_goal']):.1f}" if row["mean_steps_to_goal"] else "-"
        lines.append(
            f"| {row['env']} | {row['line'].name} | {row['training_episodes']} | {row['planner']} "
            f"| {'-' if policy else 'yes' if row['proposals'] == '1' else 'no'} | {'-' if policy else row['budget']} "
            f"| {success(row)} | {steps} "
            f"| {f'{float(smooth):.3f}' if (smooth := row.get('action_rate')) else '-'} | {float(row['plan_ms_median']):.0f}{of_cores(row)} |"
        )
    for path in sorted(set(RESULTS.glob("policy_vs_mpc_*.png")) - {HALF_TRAINED}):
        lines += ["", f"![Success of policy and planners on {path.stem.removeprefix('policy_vs_mpc_')}]({path})"]
    return lines if rows else []


def smoothing_rows() -> list[dict[str, Any]]:
    """What :func:`smoothing_table` shows."""
    return smoothing.comparable(read_results(RESULTS / "smoothing.csv"))


def smoothing_table() -> list[str]:
    """Planners with and without the smoothing layer."""
    lines = [
        "### Smoothing (`python -m benchmarks.smoothing --env NAME`)",
        "",
        "The same fresh episodes, one thread. *Action rate* is the mean squared change from one action to the next; *accepted*",
        "the share of plans that the layer made smoother, + of those that it had made at an earlier step and the search handed back",
        "unchanged; *risen* counts accepted plans whose true cost went up.",
        "",
        "| task | planner | proposals | variant | success | first hit | action rate | jerk | accepted | risen | search + smoothing [ms] |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in sorted(smoothing_rows(), key=lambda row: (row["env"], row["planner"], row["proposals"])):
        hits = [float(hit) for hit in row["first_hits"].split() if hit != "-"]
        n, rate = int(row["episodes"]), float(row["success_rate"])
        shares = [f"{float(row[name]):.2f}" for name in ("accepted_share", "kept_share") if row.get(name)]
        lines.append(
            f"| {row['env']} | {row['planner']} | {'yes' if row['proposals'] == 'True' else 'no'} | {row['variant']} "
            f"| {describe(rate, wilson_interval(round(rate * n), n))} | {f'{sum(hits) / len(hits):.1f}' if hits else '-'} "
            f"| {float(row['action_rate']):.4f} | {float(row['jerk']):.1f} | {' + '.join(shares) or '-'} | {row.get('risen') or '-'} "
            f"| {float(row['search_ms']):.0f} + {float(row['smoothing_ms']):.0f} |"
        )
    return lines
