"""Ctrl-C of a sweep: its runs are saved, its exit status is 130, and the same command finishes it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import heard

COMMAND = [sys.executable, "-m", "benchmarks.sweep", "--envs", "fetch_reach", "--methods", "sparse"]
CELL = ["--n-episodes", "400"]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("jobs", [1, 2])
def test_an_interrupted_sweep_saves_and_returns_130(tmp_path, jobs):
    surroundings = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    sweep = subprocess.Popen(
        [*COMMAND, *CELL, "--seeds", str(jobs), "--jobs", str(jobs)],
        cwd=tmp_path, env=surroundings, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        preexec_fn=heard,  # noqa: PLW1509 - nothing of this process has threads at work here
    )  # fmt: skip
    deadline = time.monotonic() + 300
    while len(list(tmp_path.glob("runs/benchmarks/*/metrics.csv"))) < jobs and time.monotonic() < deadline:
        time.sleep(0.05)
    sweep.send_signal(signal.SIGINT)  # to this one alone: a terminal would tell its whole group
    said = sweep.communicate(timeout=300)[0]
    assert sweep.returncode == 130, said
    assert "Traceback" not in said and said.count("the same command continues it") == jobs
    assert len(list(tmp_path.glob("runs/benchmarks/*/training_state.safetensors"))) == jobs
    assert not list(tmp_path.glob("results/runs/*")), "an interrupted run is no result"
