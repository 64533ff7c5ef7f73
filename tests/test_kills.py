"""Killed at any moment, a run goes on to the very same end; ``NAPSP_KILLS=25`` kills more often."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

N = int(os.environ.get("NAPSP_KILLS", "3"))


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="processes are forked")
def test_killed_runs_end_as_if_nobody_had_killed_them():
    command = [sys.executable, str(Path(__file__).with_name("kills.py")), str(N), "ours", "plus"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(f"{N} kills") == 2 and done.stdout.count("differences: []") == 2
