"""Writes the README's results from the rows in ``results/``: ``python -m benchmarks.readme``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from benchmarks import tables_planning as planning
from benchmarks import tables_speed as speed
from benchmarks import tables_training as training
from benchmarks.command import read_options
from benchmarks.tables_plus import ablation_table
from napsp.errors import run_command
from napsp.storage.files import write_atomically

README = Path("README.md")
START, END = "<!-- results:start -->", "<!-- results:end -->"
OPEN = (planning.glance_table, training.learning_table)
FOLDED = (
    planning.cost_table, planning.versus_table, planning.smoothing_table, training.training_table,
    training.accuracy_table, ablation_table, training.coverage_table, training.gate_table, speed.speed_table,
    speed.throughput_table, speed.learner_table,
)  # fmt: skip
"""Tables that a reader opens when interested."""


def folded(lines: list[str]) -> list[str]:
    """A table whose heading alone shows until it is clicked."""
    title = re.sub("`(.*?)`", r"<code>\1</code>", lines[0].removeprefix("### "))
    return ["<details>", f"<summary><b>{title}</b></summary>", *lines[1:], "", "</details>"]


def updated(text: str) -> str:
    """The README's ``text`` with the part between the two markers made anew."""
    tables = [table() for table in OPEN] + [folded(lines) for table in FOLDED if (lines := table())]
    body = "\n\n".join("\n".join(lines) for lines in tables)
    return f"{text.split(START, maxsplit=1)[0]}{START}\n\n{body}\n\n{END}{text.split(END)[1]}"


@dataclass(frozen=True)
class ReadmeOptions:
    """Write the tables of the README from the rows in results/; there is nothing to choose."""


def main() -> int:
    """Write the results into the README."""
    read_options(ReadmeOptions, "readme")
    write_atomically(README, updated(README.read_text()).encode())
    print(f"{README} updated from results/")
    return 0


if __name__ == "__main__":
    run_command(main)
