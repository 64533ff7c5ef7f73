"""A row says from which source it comes: its revision, and whether that tree had changes."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from napsp.storage.revision import revision_of


def git(tree: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=n", "-c", "user.email=e@example.org"]
    command = ["git", *identity, *arguments]
    return subprocess.run(command, cwd=tree, capture_output=True, text=True, check=True).stdout.strip()


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A file of a package in a repository that has rows, too."""
    for name in ("package/code.py", "results/speed.csv", "results/runs/one.json", "results/truth/maze.json"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1\n")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "first")
    return tmp_path / "package" / "code.py"


def test_a_clean_tree_is_its_commit(source: Path):
    assert revision_of(source) == git(source.parent, "rev-parse", "--short=12", "HEAD")


@pytest.mark.parametrize("name", ["package/code.py", "results/truth/maze.json"])
def test_changed_code_and_changed_inputs_are_marked(source: Path, name: str):
    (source.parents[1] / name).write_text("2\n")
    assert revision_of(source).endswith("+")


@pytest.mark.parametrize("name", ["results/speed.csv", "results/runs/one.json"])
def test_rows_that_a_benchmark_added_are_no_change_of_the_source(source: Path, name: str):
    (source.parents[1] / name).write_text("2\n")
    assert not revision_of(source).endswith("+")


def test_a_package_installed_inside_somebodys_repository_does_not_take_its_revision(source: Path):
    installed = source.parent / "installed.py"
    installed.write_text("1\n")
    assert revision_of(installed) == "unknown"


def test_outside_a_repository_the_revision_is_unknown(tmp_path: Path):
    assert revision_of(tmp_path / "code.py") == "unknown"
