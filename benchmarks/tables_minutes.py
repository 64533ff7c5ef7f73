"""Table of how long training takes beside another library, as lines of markdown."""

from __future__ import annotations

from benchmarks import minutes
from benchmarks.cells import read_results
from benchmarks.curves import METHODS

TASKS = ("fetch_wall", "fetch_pick_place")


def minutes_rows() -> list[dict[str, str]]:
    """A run of each task, method and seed that was timed with today's settings."""
    rows, order = read_results(minutes.FILE), (*METHODS, minutes.PEER)
    cells = sorted({(row["env"], order.index(row["method"]), int(row["seed"])) for row in rows})
    found = [minutes.answer(rows, minutes.question(env, order[method], seed)) for env, method, seed in cells]
    return [row for row in found if row is not None]


def minutes_table() -> list[str]:
    """Episodes and minutes of one core until .9 of the goals are held."""
    rows = minutes_rows()
    lines = [
        "### Minutes of training (`python -m benchmarks.minutes --env NAME`)",
        "",
        "Until the first evaluation that holds 0.9 of the goals, the same for all; CPU time of one thread, evaluations included. stable_baselines3 is its SAC + HER",
        "with the settings that RL Baselines3 Zoo publishes for FetchReach, and where there is a box for FetchPickAndPlace, of its TQC. Only minutes of the same",
        "processor compare; older rows do not name theirs, and were all taken on one machine.",
        "",
        "| task | method | seed | 0.9 first at episode | minutes of a core | processor |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        found = row["reached"] == "1"
        episodes = row["episodes"] if found else f"never in {row['episodes']} ({float(row['success_rate']):.2f})"
        spent = f"{float(row['minutes']):.2f}" if found else f"given up after {float(row['minutes']):.0f}"
        lines.append(
            f"| {row['env']} | {row['method']} | {row['seed']} | {episodes} | {spent} | {row.get('processor') or '-'} |"
        )
    missing = [env for env in TASKS if env not in {row["env"] for row in rows}]
    return lines + [f"| {env} | not run | | | | |" for env in missing]
