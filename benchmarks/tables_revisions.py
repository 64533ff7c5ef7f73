"""Table of the rows that were measured on a tree with changes, as lines of markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.cells import AGAIN, RESULTS, ROWS, learning_curves, read_results
from napsp.storage.files import read_json


def revised_rows() -> Mapping[str, Sequence[Mapping[str, Any]]]:
    """All rows, by where they are kept."""
    figures = {str(path): [read_json(path, AGAIN)] for path in sorted(RESULTS.glob("*.json"))}
    tables = {str(path): read_results(path) for path in sorted(RESULTS.glob("*.csv"))}
    return {str(ROWS): learning_curves(), **tables, **figures}


def is_changed(row: Mapping[str, Any]) -> bool:
    """Whether a row's revision, or that of the training, is of a tree with changes."""
    return any("+" in str(row.get(name) or "") for name in ("revision", "trained_at"))


def revisions_table() -> list[str]:
    """Files with such rows, and how many; nothing where there are none."""
    lines = [
        "### Rows of changed trees (`git log`)",
        "",
        "A row names the revision that it was measured at. Some older ones were measured, or their models trained, with changes that were not committed yet, which nobody can check out;",
        "all others are of committed sources.",
        "",
        "| file | rows | of changed trees |",
        "|---|---|---|",
    ]
    counts = {name: (len(rows), sum(map(is_changed, rows))) for name, rows in revised_rows().items()}
    found = [f"| {name} | {n} | {changed} |" for name, (n, changed) in counts.items() if changed]
    return [*lines, *found] if found else []
