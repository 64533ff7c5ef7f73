"""The README says what the rows in results/ say."""

import io
import re
import shutil
import subprocess
import tarfile
from pathlib import Path

import pytest

from benchmarks import readme

ROOT = Path(__file__).parents[1]
READ = ("README.md", "results", "napsp/checkpoints")


@pytest.fixture
def committed(tmp_path):
    """What was committed of the README and its rows: results of one's own need not be in it."""
    try:
        archive = subprocess.run(["git", "archive", "HEAD", *READ], cwd=ROOT, capture_output=True, check=True).stdout
        with tarfile.open(fileobj=io.BytesIO(archive)) as files:
            files.extractall(tmp_path, filter="data")
    except (OSError, subprocess.CalledProcessError):  # not a clone
        shutil.copy(ROOT / "README.md", tmp_path)
        for name in READ[1:]:
            shutil.copytree(ROOT / name, tmp_path / name)
    return tmp_path


def test_results_in_the_readme_are_those_of_the_rows(committed, monkeypatch):
    monkeypatch.chdir(committed)
    text = Path("README.md").read_text()
    assert readme.updated(text) == text, "run: python -m benchmarks.readme"


def test_links_and_pictures_of_the_readme_exist():
    text = (ROOT / "README.md").read_text()
    linked = re.findall(r"\]\(([^)#]+)\)", text) + re.findall(r"`(docs/[\w./]+)`", text)
    assert linked and not [path for path in linked if "://" not in path and not (ROOT / path).exists()]


def test_a_folded_table_shows_its_heading_and_keeps_its_rows():
    lines = readme.folded(["### Speed (`python -m x`)", "", "| a |", "|---|", "| 1 |"])
    assert lines[1] == "<summary><b>Speed (<code>python -m x</code>)</b></summary>"
    assert lines[2:6] == ["", "| a |", "|---|", "| 1 |"] and lines[-1] == "</details>"
