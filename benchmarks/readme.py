"""Writes the results of README and docs/results.md from the rows in ``results/``, and what their columns mean into
docs/glossary.md: ``python -m benchmarks.readme``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks import tables_planning as planning
from benchmarks import tables_speed as speed
from benchmarks import tables_training as training
from benchmarks.command import read_options
from benchmarks.tables_accuracy import accuracy_table, error_table, pairs_table
from benchmarks.tables_columns import columns_table
from benchmarks.tables_glance import glance_table, planned_table
from benchmarks.tables_minutes import minutes_table
from benchmarks.tables_plus import ablation_table
from benchmarks.tables_realtime import realtime_table
from benchmarks.tables_revisions import revisions_table
from benchmarks.tables_summary import summary_table
from napsp.errors import run_command
from napsp.storage.files import write_atomically

Table = Callable[[], list[str]]
README, PAGE, GLOSSARY = Path("README.md"), Path("docs") / "results.md", Path("docs") / "glossary.md"
START, END = "<!-- results:start -->", "<!-- results:end -->"
TABLES: dict[Path, tuple[Table, ...]] = {
    README: (glance_table,),
    PAGE: (
        summary_table, training.learning_table, minutes_table, planned_table, planning.cost_table,
        planning.versus_table, realtime_table, accuracy_table, error_table, pairs_table, ablation_table,
        planning.smoothing_table, training.training_table, training.coverage_table, training.gate_table,
        speed.speed_table, speed.throughput_table, speed.learner_table, revisions_table,
    ),
    GLOSSARY: (columns_table,),
}  # fmt: skip
"""What is shown where."""


def written(table: Table, page: Path) -> str:
    """A table, its links as the page needs them: they are written as seen from the top folder."""
    text = "\n".join(table())
    if page.parent == Path("."):
        return text
    text = re.sub(r"^###", "##", text, flags=re.MULTILINE)
    return text.replace("](results/", "](../results/").replace(f"]({page.parent}/", "](")


def updated(page: Path, text: str) -> str:
    """A page's ``text`` with the part between the two markers made anew."""
    tables = "\n\n".join(found for table in TABLES[page] if (found := written(table, page)))
    return f"{text.split(START, maxsplit=1)[0]}{START}\n\n{tables}\n\n{END}{text.split(END)[1]}"


@dataclass(frozen=True)
class ReadmeOptions:
    """Write the tables of README, docs/results.md and docs/glossary.md; there is nothing to choose."""


def main() -> int:
    """Write the results into the pages."""
    read_options(ReadmeOptions, "readme")
    for page in TABLES:
        write_atomically(page, updated(page, page.read_text()).encode())
        print(f"{page} updated")
    return 0


if __name__ == "__main__":
    run_command(main)
