"""README and docs/results.md say what the rows in results/ say; links and pictures of all pages exist."""

import io
import re
import shutil
import subprocess
import tarfile
from pathlib import Path

import pytest

from benchmarks import readme

ROOT = Path(__file__).parents[1]
READ = ("README.md", "docs", "results", "napsp/checkpoints")
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")])


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


@pytest.mark.parametrize("page", readme.TABLES, ids=str)
def test_results_in_the_pages_are_those_of_the_rows(page, committed, monkeypatch):
    monkeypatch.chdir(committed)
    text = page.read_text()
    assert readme.updated(page, text) == text, "run: python -m benchmarks.readme"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_pictures_and_headings_that_a_page_names_exist(page):
    text = page.read_text()
    for target in re.findall(r"\]\(([^)]+)\)", text):
        path, _, heading = target.partition("#")
        if "://" in path:
            continue
        there = page.parent / path if path else page
        assert there.exists(), target
        titles = re.findall(r"^#+ (.*)$", there.read_text(), re.MULTILINE) if heading else []
        anchors = [re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles]
        assert heading in ("", *anchors), target
    for path in re.findall(r"`((?:docs|results)/[\w./]+)`", text):
        assert (ROOT / path).exists(), path


def test_the_readme_is_short():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 200
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    assert len(prose.split()) <= 1400


def test_a_table_of_a_page_below_links_from_there():
    lines = ["### Speed", "", "![x](results/a.png) and [plus](docs/plus.md)"]
    assert readme.written(lambda: lines, Path("README.md")) == "\n".join(lines)
    below = readme.written(lambda: lines, Path("docs/results.md"))
    assert below == "## Speed\n\n![x](../results/a.png) and [plus](plus.md)"
