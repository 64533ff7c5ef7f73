"""Rows of results and trained runs: what every benchmark shares."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from napsp.checkpoint import write_atomically
from napsp.config import TrainConfig
from napsp.record import RECORD_FILE
from napsp.train import train

RESULTS = Path("results")
RUNS = Path("runs") / "benchmarks"


def trained(config: TrainConfig) -> Path:
    """Folder of the finished run of a configuration; trains it, or finishes it, when needed."""
    folder = RUNS / f"{config.env}-{config.method}-s{config.seed}-{config.hash()}"
    if not (folder / RECORD_FILE).is_file():
        print(f"training {folder}")
        train(config, folder)
    if not (folder / RECORD_FILE).is_file():
        raise KeyboardInterrupt  # an interrupted run is not a result
    return folder


def read_results(path: Path) -> list[dict[str, str]]:
    """Rows of a results file; none if it does not exist."""
    if not path.is_file():
        return []
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def find(rows: Iterable[Mapping[str, str]], key: Mapping[str, Any]) -> Mapping[str, str] | None:
    """The row whose columns equal ``key``."""
    wanted = {name: str(value) for name, value in key.items()}
    return next((row for row in rows if wanted.items() <= row.items()), None)


def append_result(path: Path, row: Mapping[str, Any]) -> None:
    """Add a row, atomically; a row of the same cell must not exist yet."""
    rows = [*read_results(path), {name: str(value) for name, value in row.items()}]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(name for r in rows for name in r)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.getvalue().encode())
