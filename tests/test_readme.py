"""The README says what the rows in results/ say."""

import re
from pathlib import Path

from benchmarks import readme

ROOT = Path(__file__).parents[1]


def test_results_in_the_readme_are_those_of_the_rows(monkeypatch):
    monkeypatch.chdir(ROOT)
    text = (ROOT / "README.md").read_text()
    assert readme.updated(text) == text, "run: python -m benchmarks.readme"


def test_links_and_pictures_of_the_readme_exist():
    text = (ROOT / "README.md").read_text()
    linked = re.findall(r"\]\(([^)#]+)\)", text) + re.findall(r"`(docs/[\w./]+)`", text)
    assert linked and not [path for path in linked if "://" not in path and not (ROOT / path).exists()]


def test_a_folded_table_shows_its_heading_and_keeps_its_rows():
    lines = readme.folded(["### Speed (`python -m x`)", "", "| a |", "|---|", "| 1 |"])
    assert lines[1] == "<summary><b>Speed (<code>python -m x</code>)</b></summary>"
    assert lines[2:6] == ["", "| a |", "|---|", "| 1 |"] and lines[-1] == "</details>"
