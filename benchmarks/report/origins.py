"""Where the figures of a table come from: the command, the rows, their revisions and seeds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks import tables_planning as planning
from benchmarks import tables_speed as speed
from benchmarks import tables_training as training
from benchmarks.cells import RESULTS, read_results
from benchmarks.readme import Table
from benchmarks.tables_accuracy import accuracy_groups, accuracy_table, error_table, pairs_table
from benchmarks.tables_glance import glance_rows, glance_table, planned_rows, planned_table
from benchmarks.tables_minutes import minutes_rows, minutes_table
from benchmarks.tables_plus import ablation_rows, ablation_table
from benchmarks.tables_realtime import realtime_rows, realtime_table
from benchmarks.tables_revisions import revised_rows, revisions_table
from benchmarks.tables_summary import summary_rows, summary_table

Rows = Callable[[], Iterable[Mapping[str, Any]]]


@dataclass(frozen=True)
class Origin:
    """What a table was made from.

    Attributes:
        command: makes its rows.
        files: where they are kept.
        rows: those that the table shows, all of them.
        trained: their column with the training seed; empty where nothing was trained.
        played: the column with the seed of the first of their ``episodes``; empty where training was all.
    """

    command: str
    files: str
    rows: Rows
    trained: str = ""
    played: str = ""

    def found(self) -> Found:
        """Of the rows as they are now."""
        rows = list(self.rows())
        named = [text for row in rows for text in (row.get("revision"), row.get("trained_at")) if text]
        trained = {int(row[self.trained]) for row in rows if self.trained and row[self.trained] != ""}
        spans = {
            (int(row[self.played]), int(row["episodes"])) for row in rows if self.played and row[self.played] != ""
        }
        played = {first + k for first, n in spans for k in range(n)}
        return Found(sorted({part for text in named for part in text.split(", ")}), ranges(trained), ranges(played))


@dataclass(frozen=True)
class Found:
    """What the rows of a table name.

    Attributes:
        revisions: of the source, each once.
        training_seeds: such as ``0 to 4``; empty without any.
        episode_seeds: such as ``90000 to 90049``.
    """

    revisions: list[str]
    training_seeds: str
    episode_seeds: str


def ranges(numbers: set[int]) -> str:
    """Whole numbers as text, neighbours together."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ", ".join(str(low) if low == high else f"{low} to {high}" for low, high in runs)


ROWS_OF_RUNS = "results/runs"
ORIGINS: dict[Table, Origin] = {
    glance_table: Origin(
        "python -m benchmarks.policy_vs_mpc --env NAME --checkpoint NAME_plus; "
        "python -m benchmarks.distance_as_cost --env NAME; python -m benchmarks.sweep",
        f"results/policy_vs_mpc.csv, results/distance_as_cost.csv, {ROWS_OF_RUNS}", glance_rows,
        "training_seed", "seed",
    ),
    summary_table: Origin(
        "python -m benchmarks.sweep; python -m benchmarks.distance_accuracy --env NAME; "
        "python -m benchmarks.distance_as_cost --env NAME; "
        "python -m benchmarks.policy_vs_mpc --env NAME --checkpoint NAME_plus --budgets 4 8 16",
        f"{ROWS_OF_RUNS}, results/distance_accuracy.csv, results/distance_as_cost.csv, results/policy_vs_mpc.csv",
        summary_rows, "training_seed", "seed",
    ),
    planned_table: Origin(
        "python -m benchmarks.policy_vs_mpc --env NAME --checkpoint NAME_plus", "results/policy_vs_mpc.csv",
        planned_rows, "training_seed", "seed",
    ),
    training.learning_table: Origin("python -m benchmarks.sweep", ROWS_OF_RUNS, training.learning_rows, "seed"),
    minutes_table: Origin(
        "python -m benchmarks.minutes --env NAME", "results/minutes.csv", minutes_rows, "seed"
    ),
    planning.cost_table: Origin(
        "python -m benchmarks.distance_as_cost --env NAME", "results/distance_as_cost.csv", planning.cost_rows,
        "training_seed", "seed",
    ),
    planning.versus_table: Origin(
        "python -m benchmarks.policy_vs_mpc --env NAME", "results/policy_vs_mpc.csv", planning.versus_rows,
        "training_seed", "seed",
    ),
    realtime_table: Origin(
        "python -m benchmarks.policy_vs_mpc --env NAME --checkpoint NAME_plus --budgets 4 8 16",
        "results/policy_vs_mpc.csv", realtime_rows, "training_seed", "seed",
    ),
    accuracy_table: Origin(
        "python -m benchmarks.distance_accuracy --env NAME", "results/distance_accuracy.csv",
        lambda: [row for group in accuracy_groups().values() for row in group], "seed",
    ),
    pairs_table: Origin(
        "python -m benchmarks.distance_accuracy --env NAME", "results/distance_accuracy.csv",
        lambda: [row for group in accuracy_groups().values() for row in group if row["seed"] and not row["n_starts"]],
        "seed",
    ),
    error_table: Origin(
        "python -m benchmarks.distance_accuracy --env NAME", "results/distance_accuracy.csv",
        lambda: [row for group in accuracy_groups().values() for row in group], "seed",
    ),
    ablation_table: Origin("python -m benchmarks.ablation --env NAME", ROWS_OF_RUNS, ablation_rows, "seed"),
    planning.smoothing_table: Origin(
        "python -m benchmarks.smoothing --env NAME", "results/smoothing.csv", planning.smoothing_rows,
        "training_seed", "seed",
    ),
    training.training_table: Origin(
        "those of the table", "napsp/checkpoints", lambda: training.shipped_records().values(), "seed"
    ),
    training.coverage_table: Origin(
        "python -m benchmarks.coverage", "results/coverage.csv", lambda: [row for _, row in training.coverage_rows()],
        "seed",
    ),
    training.gate_table: Origin(
        "python -m benchmarks.count_gate --env NAME", "results/count_gate.csv", lambda: training.gate_rows().values()
    ),
    speed.speed_table: Origin(
        "python -m benchmarks.rollout_speed --env NAME", f"results/{speed.SPEED}", lambda: speed.json_rows(speed.SPEED)
    ),
    speed.throughput_table: Origin(
        "python -m benchmarks.throughput", "results/throughput.csv", lambda: read_results(RESULTS / "throughput.csv")
    ),
    speed.learner_table: Origin(
        "python -m benchmarks.learner_speed", f"results/{speed.LEARNER}", lambda: speed.json_rows(speed.LEARNER)
    ),
    revisions_table: Origin(
        "git log", "results", lambda: [row for rows in revised_rows().values() for row in rows]
    ),
}  # fmt: skip
"""Of every table of results."""
