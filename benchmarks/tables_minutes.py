"""Table of how long training takes beside another library, as lines of markdown."""

from __future__ import annotations

import numpy as np

from benchmarks import minutes
from benchmarks.cells import read_results
from benchmarks.curves import METHODS
from napsp.envs.cards import CARDS, suite


def minutes_rows() -> list[dict[str, str]]:
    """A run of each task, processor, method and seed that was timed with today's settings."""
    rows, order, tasks = read_results(minutes.FILE), (*METHODS, minutes.PEER), list(CARDS)
    cells = {(row["env"], row.get("processor", ""), order.index(row["method"]), int(row["seed"])) for row in rows}
    found = [
        minutes.answer(rows, minutes.question(env, order[method], seed, processor))
        for env, processor, method, seed in sorted(cells, key=lambda cell: (tasks.index(cell[0]), cell[1:]))
    ]
    return [row for row in found if row is not None]


def minutes_table() -> list[str]:
    """Episodes and minutes of one core until .9 of the goals are held."""
    groups: dict[tuple[str, str, str], list[dict[str, str]]] = {}
    for row in minutes_rows():
        groups.setdefault((row["env"], row.get("processor", ""), row["method"]), []).append(row)
    lines = [
        "### Minutes of training (`python -m benchmarks.minutes --env NAME`)",
        "",
        "Until the first evaluation that holds 0.9 of the goals, the same for all: median over training seeds, least and most. CPU time of one thread, evaluations included, other work",
        "beside. stable_baselines3 is its SAC + HER with the settings that RL Baselines3 Zoo publishes for FetchReach, and where there is a box for FetchPickAndPlace, of its",
        "TQC. Minutes of different processors do not compare; the oldest rows do not name theirs, which was the same for all of them.",
        "",
        "| task | processor | method | seeds | 0.9 first at episode | minutes of a core |",
        "|---|---|---|---|---|---|",
    ]
    for (env, processor, method), rows in groups.items():
        lines.append(f"| {env} | {processor or '-'} | {method} | {len(rows)} | {' | '.join(_cells(rows))} |")
    missing = [env for env in suite("paper") if env not in {env for env, _, _ in groups}]
    return lines + [f"| {env} | not run | | | | |" for env in missing]


def _cells(rows: list[dict[str, str]]) -> list[str]:
    """Episodes and minutes; of seeds that were given up how far they had come."""
    reached = [row for row in rows if row["reached"] == "1"]
    late = [row for row in rows if row["reached"] != "1"]
    cells = [
        _over([float(row[name]) for row in reached], form) for name, form in (("episodes", ".0f"), ("minutes", ".2f"))
    ]
    if late:
        many = f", {len(late)} of {len(rows)} " if reached else ""
        most = max(float(row["success_rate"]) for row in late)
        cells[0] += (
            f"{many}never in {_over([float(row['episodes']) for row in late], '.0f')} (success at most {most:.2f})"
        )
        cells[1] += f"{many}given up after {_over([float(row['minutes']) for row in late], '.0f')}"
    return cells


def _over(values: list[float], form: str) -> str:
    """Median, least and most."""
    if not values:
        return ""
    low, high = f"{min(values):{form}}", f"{max(values):{form}}"
    return f"{np.median(values):{form}}" + (f" ({low} to {high})" if low != high else "")
