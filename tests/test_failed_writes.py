"""Writes that fail leave the last state and give one sentence; ``NAPSP_FAILED_WRITES=100`` lets more of them fail."""

import builtins
import errno
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from test_saving import few
from tiny import fingerprint

from napsp import train as training
from napsp.config import preset
from napsp.errors import run_command
from napsp.run import Run
from napsp.settings import as_flags, differences
from napsp.storage.checkpoint import load_model
from napsp.storage.state import STATE_FILE
from napsp.train import train

N = int(os.environ.get("NAPSP_FAILED_WRITES", "6"))
CALLS = ("open", "write", "fsync", "replace", "mkdir")


class Disk:
    """Lets the n-th of all calls that write fail, in the folder of a run alone.

    A write that fails leaves half of its bytes, as a full disk does.
    """

    def __init__(self, monkeypatch, folder, failing=None, error=errno.ENOSPC):
        self.n, self._folder, self._failing, self._error = 0, str(folder), failing, error
        for name in ("fsync", "replace", "mkdir"):
            monkeypatch.setattr(os, name, self._counted(getattr(os, name), name))
        opened = builtins.open
        monkeypatch.setattr(builtins, "open", lambda *a, **k: self._open(opened, *a, **k))

    def _count(self):
        self.n += 1
        if self.n == self._failing:
            raise OSError(self._error, os.strerror(self._error))

    def _counted(self, function, name):
        def call(first, *arguments, **named):
            made = name == "mkdir" and os.path.isdir(first)  # whether asking for it again fails is nobody's concern
            if not made and (name == "fsync" or str(first).startswith(self._folder)):
                self._count()
            return function(first, *arguments, **named)

        return call

    def _open(self, opened, file, mode="r", *arguments, **named):
        if "w" not in mode or not str(file).startswith(self._folder):
            return opened(file, mode, *arguments, **named)
        self._count()
        made = opened(file, mode, *arguments, **named)
        write = made.write
        disk = self

        class Failing:
            def __enter__(self):
                return self

            def __exit__(self, *error):
                made.close()

            def __getattr__(self, name):
                return getattr(made, name)

            def write(self, data):
                try:
                    disk._count()
                except OSError:
                    write(data[: len(data) // 2])
                    raise
                return write(data)

        return Failing()


def command(config, folder, monkeypatch, capsys):
    """Exit status and what the command says about it."""
    flags = as_flags(differences(config, preset("point_maze"))).split()
    monkeypatch.setattr(sys, "argv", ["napsp.train", "--env", "point_maze", "--out", str(folder), *flags])
    with pytest.raises(SystemExit) as end:
        run_command(training.main)
    return end.value.code, capsys.readouterr().err


def test_whichever_write_fails_the_last_state_stands_and_one_sentence_says_so(tmp_path, monkeypatch, capsys):
    config, finish, states = few(), Run.finish_iteration, {}
    train(few(n_episodes=8), tmp_path / "start")

    def kept(self, iteration, metrics):
        ended = finish(self, iteration, metrics)
        states.setdefault(iteration, fingerprint(self.folder))
        return ended

    shutil.copytree(tmp_path / "start", tmp_path / "whole")
    states[1] = fingerprint(tmp_path / "whole")
    with monkeypatch.context() as patch:
        patch.setattr(Run, "finish_iteration", kept)
        disk = Disk(patch, tmp_path / "whole")
        train(config, tmp_path / "whole")
    n_calls, end = disk.n, fingerprint(tmp_path / "whole")
    known = set(states.values())
    rng, n_ended = np.random.default_rng(0), 0
    for trial in range(N):
        folder = tmp_path / f"run{trial}"
        shutil.copytree(tmp_path / "start", folder)
        with monkeypatch.context() as patch:
            Disk(patch, folder, int(rng.integers(1, n_calls + 1)), int(rng.choice([errno.ENOSPC, errno.EIO])))
            status, said = command(config, folder, patch, capsys)
        assert status == 2 and said.startswith("error: ") and said.count("\n") == 1, said
        assert fingerprint(folder) in known, "no state of the run"
        load_model(folder, "point_maze")
        if trial % 10 == 0:
            train(config, folder)
            assert fingerprint(folder) == end
            n_ended += 1
        shutil.rmtree(folder)
    assert n_ended == -(-N // 10) and n_calls > 30


FULL = """
import resource, sys
from napsp import train
from napsp.errors import run_command
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)), resource.RLIM_INFINITY))
run_command(train.main)
"""


@pytest.mark.slow
def test_files_that_the_system_does_not_let_grow_are_one_sentence(tmp_path):
    train(few(n_episodes=8), tmp_path)
    before, size = fingerprint(tmp_path), (tmp_path / STATE_FILE).stat().st_size
    flags = as_flags(differences(few(), preset("point_maze"))).split()
    ended = subprocess.run(
        [sys.executable, "-c", FULL, str(size // 2), "--env", "point_maze", "--out", str(tmp_path), *flags],
        capture_output=True, text=True,
    )  # fmt: skip
    assert ended.returncode == 2 and ended.stderr.startswith("error: ") and "Traceback" not in ended.stderr
    assert fingerprint(tmp_path) == before
