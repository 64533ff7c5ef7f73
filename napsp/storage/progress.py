"""What a training run says while it works: a live line, a table, CSV, TensorBoard."""

from __future__ import annotations

import csv
import io
import sys
import time
from pathlib import Path

from napsp.errors import UserError
from napsp.storage.files import write_atomically

COLUMNS = {
    "episodes": ("episodes", "{:8.0f}"),
    "success_rate": ("success", "{:7.2f}"),
    "any_success_rate": ("any", "{:5.2f}"),
    "mean_gap": ("gap [m]", "{:7.3f}"),
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
Row = dict[str, float]


class Progress:
    """Writes one row per evaluation to the screen and to ``metrics.csv``."""

    def __init__(self, folder: Path, rows: list[Row], tensorboard: bool, method: str = "ours") -> None:
        hidden = NOT_OF_PLUS if method in ("plus", "qrl") else OF_PLUS
        self._columns = {name: column for name, column in COLUMNS.items() if name not in hidden}
        self._path = folder / "metrics.csv"
        self.rows = rows
        self._live = sys.stdout.isatty()
        self._last_live = 0.0
        self._writer = _tensorboard(folder) if tensorboard else None
        print("  ".join(title.rjust(_width(form)) for title, form in self._columns.values()), flush=True)

    def tick(self, done: int, total: int, seconds_left: float) -> None:
        """Refresh the live line, at most five times a second, and only on a terminal."""
        now = time.monotonic()
        if self._live and now - self._last_live > 0.2:
            self._last_live = now
            print(f"\r  episode {done}/{total}, {seconds_left / 60:.1f} min left ", end="", flush=True)

    def report(self, row: Row) -> None:
        """Append an evaluation."""
        self.rows.append(row)
        write_rows(self._path, self.rows)
        cells = [
            form.format(row[name]) if row.get(name, float("nan")) == row.get(name) else "-".rjust(_width(form))
            for name, (_, form) in self._columns.items()
        ]
        print(("\r" if self._live else "") + "  ".join(cells), flush=True)
        if self._writer is not None:
            for name, value in row.items():
                self._writer.add_scalar(name, value, int(row["episodes"]))

    def close(self) -> None:
        """Flush TensorBoard."""
        if self._writer is not None:
            self._writer.close()


def _width(form: str) -> int:
    return max(len(form.format(0.0)), 5)


def _tensorboard(folder: Path):  # noqa: ANN202 - the class exists only with the extra
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        raise UserError("TensorBoard is not installed; run: pip install 'napsp[tensorboard]'") from None
    return SummaryWriter(str(folder / "tensorboard"))


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
