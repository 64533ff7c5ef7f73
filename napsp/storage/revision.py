"""Which source the running code comes from."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

EVERYTHING_BUT_ROWS = [":(top)", ":(top,exclude,glob)results/*.*", ":(top,exclude)results/runs"]


@cache
def git_revision() -> str:
    """Revision of the source tree, with "+" if it has changes; "unknown" outside git.

    Rows and figures that benchmarks added under `results/` are no change: each row names its own revision, and the next
    command would otherwise be blamed for what the last one found. Read once: the code that runs is the code that was
    there when the process started.
    """
    return revision_of(Path(__file__))


def revision_of(file: Path) -> str:
    """Revision of the tree that tracks `file`; "unknown" where none does, as for a package in somebody's repository."""
    try:
        _git(file, "ls-files", "--error-unmatch", file.name)
        revision = _git(file, "rev-parse", "--short=12", "HEAD")
        changed = _git(file, "status", "--porcelain", "-uno", "--", *EVERYTHING_BUT_ROWS)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return revision + ("+" if changed else "")


def _git(file: Path, *arguments: str) -> str:
    options = {"cwd": file.parent, "capture_output": True, "text": True, "check": True, "timeout": 10}
    return subprocess.run(["git", *arguments], **options).stdout.strip()
