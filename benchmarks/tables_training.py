"""Tables of training: the paper's comparison, shipped checkpoints, distance accuracy, coverage; markdown lines."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cells import RESULTS, read_results, training_of
from benchmarks.coverage import CoverageOptions
from benchmarks.curves import Line, current_runs, expected_lines, full_line_of, is_current
from benchmarks.units import in_unit
from napsp.config import DEFAULT, OF_THE_GATE, from_dict, preset
from napsp.envs.cards import suite
from napsp.settings import flat, to_dict
from napsp.statistics import describe, interquartile_mean
from napsp.storage.record import command_line


def _current(name: str, **sizes: int) -> list[tuple[str, dict[str, str]]]:
    """Rows of these sizes and what was measured: a line of today, or one of older versions while that has no row.

    Rows of other settings stay in the file only.
    """
    rows = [row for row in read_results(RESULTS / name) if all(row[k] == str(v) for k, v in sizes.items())]
    found: list[tuple[Line | None, dict[str, str]]] = []
    for row in rows:
        training = training_of(row)
        line = full_line_of(training) if training else None
        if line is not None or training is None:  # nothing was learned for the straight line
            found.append((line, row))
    measured = {env: {line for line, row in found if line and row["env"] == env} for env in {r["env"] for r in rows}}
    return [
        (line.name if line else row["method"], row)
        for line, row in found
        if line is None or is_current(line, measured[row["env"]])
    ]


def shipped_records() -> dict[str, dict[str, Any]]:
    """Records of the checkpoints that ship, by name."""
    return {
        path.parent.name: json.loads(path.read_text())
        for path in sorted(Path("napsp/checkpoints").glob("*/training.json"))
    }


def training_table() -> list[str]:
    """Final evaluation of the shipped checkpoints."""
    lines = [
        "### Shipped checkpoints",
        "",
        "*Otherwise* names options that the command of today does not have and what they were: *counts.reached_bits* is the one joint key",
        "of N(s, a, g) that today's two-part key replaced.",
        "",
        "| checkpoint | command | otherwise | episodes | wall minutes, machine shared | success | d at the goal |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, record in shipped_records().items():
        final, stored, usual = record["final"], flat(record["config"]), flat(to_dict(DEFAULT))
        task = flat(to_dict(preset(stored["env"])))
        lacking = {
            option: task[option] for option in OF_THE_GATE if option not in stored
        }  # of a key that it did not have
        known = {option: value for option, value in stored.items() if option in usual}
        command = command_line(from_dict({**known, **lacking}))
        otherwise = ", ".join(f"{option} {value}" for option, value in stored.items() if option not in usual)
        lines.append(
            f"| {name} | `{command}` | {otherwise or '-'} | {record['episodes']:.0f} | {record['minutes']:.1f} "
            f"| {final['success_rate']:.2f} | {final.get('distance_at_goal', float('nan')):.1f} |"
        )
    return lines


def learning_rows() -> list[dict[str, Any]]:
    """The runs of :func:`learning_table`."""
    return [run for env in (*suite("paper"), *suite("harder")) for runs in current_runs(env).values() for run in runs]


def learning_table() -> list[str]:
    """Final evaluation of every cell of the paper's comparison, over training seeds."""
    lines = [
        "### The paper's comparison (`python -m benchmarks.sweep`, `python -m benchmarks.curves`)",
        "",
        "![Learning curves of all tasks and methods](results/figure3.png)",
        "",
        "Last evaluation of each training run, on goals that all methods and seeds share; interquartile mean over seeds with its",
        "95 % bootstrap interval (three seeds or more). *Success* is being at the goal in the last step, *maximum reward* the least",
        "distance to the goal in an episode, negated (of the claw an angle; the oldest runs did not record it). *0.5 first at episode* and its neighbours: the",
        "first evaluation with so much success, median over seeds, and how many of them got there.",
        "*+ manipulation* is `--recipe manipulation`, with what pick and place is learned with beyond the paper, *first arrival*",
        "`--temporal.first-arrival`, which the paper does not have either. Some lines are of older versions, and are shown until today's were",
        "run: *one key* counted N(s, a, g) by one joint key of s, a and g, which today has two parts; *alpha >=* is",
        "`--policy.min-entropy-weight`, which was 0.02 in units of reward for every task and today is in lost steps; *stay 0* is plus when it",
        "asked no arrival to last.",
        "The last two tasks are not the paper's, but harder ones.",
        "",
        "![Success on the two harder tasks](results/harder_tasks.png)",
        "",
        "| task | method | seeds | episodes | success | some-step success | maximum reward [m, claw °] | 0.5 first at episode | 0.9 | 1.0 |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for env in (*suite("paper"), *suite("harder")):
        runs = current_runs(env)
        for line in sorted({*expected_lines(env), *runs}, key=Line.rank):
            cells = ["not run", *[""] * 7]
            if line in runs:
                last = [{k: in_unit(env, k, v) for k, v in run["curve"][-1].items()} for run in runs[line]]
                summaries = [summary(last, k) for k in ("success_rate", "any_success_rate", "max_reward")]
                first = [first_at(runs[line], rate) for rate in (0.5, 0.9, 1.0)]
                wanted = preset(env, line.method, line.recipe).n_episodes
                done = min(int(row["episodes"]) for row in last)
                length = str(done) if done >= wanted else f"{done} of {wanted}"
                cells = [str(len(last)), length, *summaries, *first]
            lines.append(f"| {env} | {line.name} | {' | '.join(cells)} |")
    return lines


def summary(rows: list[dict[str, float]], column: str) -> str:
    """Interquartile mean and interval, and how many rows had the column where not all did."""
    return over_seeds([row[column] for row in rows if column in row], len(rows))


def over_seeds(values: list[float], wanted: int, digits: int = 2) -> str:
    """Interquartile mean and interval, and how many values there are where that is fewer than wanted."""
    if not values:
        return "-"
    few = f" ({len(values)} seed{'s' * (len(values) > 1)})" if len(values) < wanted else ""
    return describe(*interquartile_mean(values), digits) + few


def first_at(runs: list[dict[str, Any]], rate: float) -> str:
    """Median over seeds of the episode at which success first came to a rate, and how many seeds got there."""
    reached = [[row["episodes"] for row in run["curve"] if row["success_rate"] >= rate] for run in runs]
    first = [episodes[0] if episodes else np.inf for episodes in reached]
    median = np.median(first)  # half of an odd pair is never
    return f"{f'{median:.0f}' if np.isfinite(median) else 'never'} ({np.isfinite(first).sum()} of {len(runs)})"


def coverage_rows() -> list[tuple[str, dict[str, str]]]:
    """Lines and rows of :func:`coverage_table`."""
    return _current("coverage.csv", bins=CoverageOptions.bins)


def coverage_table() -> list[str]:
    """State coverage of the four methods."""
    lines = [
        "### State coverage, figure 6 (`python -m benchmarks.coverage`)",
        "",
        "![State coverage of the four methods in the long maze](results/coverage_point_maze_long.png)",
        "",
        "| task | method | seed | episodes | house covered | goal room covered | success | any-step success |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, row in coverage_rows():
        names = ("coverage", "goal_room_coverage", "success_rate", "any_success_rate")
        figures = [f"{float(row[k]):.2f}" for k in names]
        lines.append(f"| {row['env']} | {name} | {row['seed']} | {row['episodes']} | {' | '.join(figures)} |")
    return lines


def gate_rows() -> dict[str, dict[str, str]]:
    """Rows of :func:`gate_table`, by task."""
    rows = {row["env"]: row for row in read_results(RESULTS / "count_gate.csv")}
    return {env: rows[env] for env in (*suite("paper"), *suite("harder"), *suite("variant")) if env in rows}


def gate_table() -> list[str]:
    """How often the gate of eq. 4b errs."""
    lines = [
        "### The gate of eq. 4b (`python -m benchmarks.count_gate --env fetch_wall`)",
        "",
        "Shares of N(s, a, g) > 0. *False*: for goals that no episode came within two radii of - places nobody came near, and goals of the",
        "task with their visitors left out of the counts; the worse of the two. *True*: half a radius beside a state that the same episode",
        "reached later. After the random warm-up episodes, and with 1000 episodes of the trained policy and its exploration.",
        "",
        "| task | warm-up episodes | false | true | all episodes | false | true |",
        "|---|---|---|---|---|---|---|",
    ]
    rows = gate_rows()
    for env, row in rows.items():
        lines.append(f"| {env} | {' | '.join([*_gate(row, 'warmup'), *_gate(row, 'trained')])} |")
    return lines if rows else []


def _gate(row: Mapping[str, str], kind: str) -> list[str]:
    """Episodes, worse false rate and true rate of one kind of data."""
    if not row.get(f"{kind}_true"):
        return ["not run", "-", "-"]
    false = [float(row[f"{kind}_false_{where}"]) for where in ("anywhere", "left_out")]
    return [row[f"{kind}_episodes"], f"{np.nanmax(false):.3f}", f"{float(row[f'{kind}_true']):.2f}"]
