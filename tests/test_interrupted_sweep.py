"""Ctrl-C of a sweep: its runs are saved, its exit status is 130, and the same command finishes it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import heard, in_this_process

from napsp.run import Run

CELL = ["--envs", "fetch_reach", "--methods", "sparse", "--n-episodes", "400"]

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals")


def check_saved(folder, n):
    assert len(list(folder.glob("runs/benchmarks/*/training_state.safetensors"))) == n
    assert not list(folder.glob("results/runs/*")), "an interrupted run is no result"


def test_interrupted_it_saves_and_returns_130(tmp_path, capsys, monkeypatch):
    finish = Run.finish_iteration

    def interrupted(run, *arguments):
        os.kill(os.getpid(), signal.SIGINT)
        return finish(run, *arguments)

    monkeypatch.setattr(Run, "finish_iteration", interrupted)
    monkeypatch.chdir(tmp_path)
    status, said = in_this_process("benchmarks.sweep", *CELL, "--seeds", "1", capsys=capsys, monkeypatch=monkeypatch)
    assert status == 130 and said.strip() == "interrupted"
    check_saved(tmp_path, 1)


@pytest.mark.slow
def test_so_do_its_processes_and_each_hears_of_it_once(tmp_path):
    surroundings = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    command = [sys.executable, "-m", "benchmarks.sweep", *CELL, "--seeds", "2", "--jobs", "2"]
    with open(tmp_path / "said", "wb") as file:
        sweep = subprocess.Popen(command, cwd=tmp_path, env=surroundings, stdout=file, stderr=subprocess.STDOUT,
                                 preexec_fn=heard)  # noqa: PLW1509 - no threads are at work here # fmt: skip
    deadline = time.monotonic() + 300
    while (tmp_path / "said").read_text().count("success") < 2 and time.monotonic() < deadline:
        time.sleep(0.05)  # the heads of the tables
    time.sleep(1)
    sweep.send_signal(signal.SIGINT)  # to this one alone: a terminal would tell its whole group
    assert sweep.wait(timeout=300) == 130
    said = (tmp_path / "said").read_text()
    assert "Traceback" not in said and said.count("the same command continues it") == 2
    check_saved(tmp_path, 2)
