"""Which source the running code comes from."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path


@cache
def git_revision() -> str:
    """Revision of the source tree, with "+" if it has changes; "unknown" outside git.

    Read once: the code that runs is the code that was there when the process started.
    """
    root = Path(__file__).parent
    try:
        options = {"cwd": root, "capture_output": True, "text": True, "check": True, "timeout": 10}
        revision = subprocess.run(["git", "rev-parse", "--short=12", "HEAD"], **options).stdout.strip()
        changed = subprocess.run(["git", "status", "--porcelain", "-uno"], **options).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return revision + ("+" if changed else "")
