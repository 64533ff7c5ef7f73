"""What a training run says while it works: how far it is, a table, CSV, and trackers."""

from __future__ import annotations

import csv
import io
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from napsp.errors import UserError
from napsp.storage.files import write_atomically
from napsp.storage.trackers import Row, Tracker

COLUMNS = {
    "episodes": ("episodes", "{:8.0f}"),
    "success_rate": ("success", "{:7.2f}"),
    "any_success_rate": ("any", "{:5.2f}"),
    "mean_gap": ("gap [m]", "{:7.3f}"),
    "mean_degrees": ("gap [deg]", "{:9.1f}"),
    "mean_distance": ("mean d", "{:7.1f}"),
    "distance_at_goal": ("d(goal)", "{:7.1f}"),
    "merging_rate": ("merge", "{:6.3f}"),
    "relaxation_rate": ("relax", "{:6.3f}"),
    "entropy_weight": ("alpha", "{:6.3f}"),
    "n_cells": ("cells", "{:6.0f}"),
    "known": ("known", "{:6.2f}"),
    "steps_per_second": ("steps/s", "{:7.0f}"),
    "minutes_left": ("min left", "{:8.1f}"),
}
OF_PLUS = ("n_cells", "known")
NOT_OF_PLUS = ("merging_rate", "relaxation_rate", "entropy_weight")


ON_A_TERMINAL, ELSEWHERE = 0.2, 15.0
"""Seconds between two signs of life: on a terminal one line is rewritten, in a file or a pipe each is a line."""


class Progress:
    """Writes one row per evaluation to the screen, to ``metrics.csv`` and to the trackers.

    ``unit`` is that of gaps between goals, see :func:`napsp.envs.gap.goal_gap`.
    """

    def __init__(
        self, folder: Path, rows: list[Row], trackers: Sequence[Tracker] = (), method: str = "ours", unit: str = "m"
    ) -> None:
        hidden = [*(NOT_OF_PLUS if method in ("plus", "qrl") else OF_PLUS)]
        hidden.append("mean_gap" if unit == "deg" else "mean_degrees")
        self._columns = {name: column for name, column in COLUMNS.items() if name not in hidden}
        if not unit:
            self._columns["mean_gap"] = ("gap", COLUMNS["mean_gap"][1])
        self._path = folder / "metrics.csv"
        self.rows = rows
        self._live = sys.stdout.isatty()
        self._last = time.monotonic()
        self._trackers = trackers
        print("  ".join(title.rjust(_width(form)) for title, form in self._columns.values()), flush=True)

    def tick(self, done: int, total: int, seconds_left: float) -> None:
        """Say how far the training is, if the last word was a while ago."""
        now = time.monotonic()
        if now - self._last > (ON_A_TERMINAL if self._live else ELSEWHERE):
            self._last = now
            text = f"  episode {done}/{total}, {seconds_left / 60:.1f} min left"
            print(f"\r{text} " if self._live else text, end="" if self._live else "\n", flush=True)

    def report(self, row: Row) -> None:
        """Append an evaluation."""
        self.rows.append(row)
        self._last = time.monotonic()
        write_rows(self._path, self.rows)
        cells = [
            form.format(row[name]) if row.get(name, float("nan")) == row.get(name) else "-".rjust(_width(form))
            for name, (_, form) in self._columns.items()
        ]
        print(("\r" if self._live else "") + "  ".join(cells), flush=True)
        for tracker in self._trackers:
            tracker.add(row)

    def close(self) -> None:
        """Let the trackers write what is left."""
        for tracker in self._trackers:
            tracker.close()


def _width(form: str) -> int:
    return max(len(form.format(0.0)), 5)


def write_rows(path: Path, rows: list[Row]) -> None:
    """Write rows as CSV, atomically; the columns are those of any row, in order of appearance."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, text.getvalue().encode())


def read_rows(path: Path, up_to_episode: float) -> list[Row]:
    """Rows written before a checkpoint; later ones belong to work that was lost.

    Raises:
        UserError: the file does not hold rows of numbers.
    """
    if not path.is_file():
        return []
    try:
        with open(path, newline="") as file:
            rows = [{k: float(v) for k, v in row.items() if v} for row in csv.DictReader(file, strict=True)]
        return [row for row in rows if row["episodes"] <= up_to_episode]
    except (ValueError, KeyError, TypeError, AttributeError, csv.Error) as error:
        raise UserError(f"{path} is damaged ({error!r}); put back a copy, or begin anew with --restart") from None
