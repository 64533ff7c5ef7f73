"""How a run ends, whatever happens: what is said was saved is there, and its record says what was done."""

import json
import os
import signal

import numpy as np
import pytest
from tiny import tiny

import napsp
from napsp.errors import UserError
from napsp.execution import Execution
from napsp.run import Run
from napsp.storage.checkpoint import load_model
from napsp.train import train


def interrupt_in(monkeypatch, iteration, times=1):
    """Ctrl-C so many times while the episodes of an iteration are collected."""
    collect, calls = Run.collect, []

    def interrupted(self, policy):
        calls.append(None)
        for _ in range(times if len(calls) == iteration else 0):
            os.kill(os.getpid(), signal.SIGINT)
        return collect(self, policy)

    monkeypatch.setattr(Run, "collect", interrupted)


def test_a_second_interrupt_before_the_first_save_says_that_nothing_is_there(tmp_path, monkeypatch, capsys):
    interrupt_in(monkeypatch, 1, times=2)
    with pytest.raises(KeyboardInterrupt):
        train(tiny(), tmp_path / "run")
    assert "not saved; the same command begins anew" in capsys.readouterr().out
    assert not list((tmp_path / "run").glob("*.safetensors"))


def full(*args):
    raise OSError(28, "No space left on device")


def test_a_full_disk_is_not_said_to_have_saved(tmp_path, monkeypatch, capsys):
    interrupt_in(monkeypatch, 1)
    monkeypatch.setattr("napsp.storage.state.write_tensors", full)
    with pytest.raises(OSError, match="No space"):
        train(tiny(), tmp_path)
    assert "saved in" not in capsys.readouterr().out


def test_an_interrupted_run_can_end_where_it_is_and_not_before(tmp_path, monkeypatch, capsys):
    with monkeypatch.context() as patched:
        interrupt_in(patched, 3)
        assert [row["episodes"] for row in train(tiny(), tmp_path)] == [8]
    with pytest.raises(UserError, match="has 10 episodes already; ask for as many with --n-episodes"):
        train(tiny(n_episodes=8), tmp_path)
    assert [row["episodes"] for row in train(tiny(n_episodes=10), tmp_path)] == [8, 10]
    assert "continues it" not in capsys.readouterr().out.splitlines()[-1]
    record, model = json.loads((tmp_path / "training.json").read_text()), load_model(tmp_path, "point_maze")
    assert record["episodes"] == model.header["episodes"] == 10 and "--n-episodes 10" in record["command"]


def test_what_belongs_to_an_older_run_goes_with_it(tmp_path):
    for options in ({"n_episodes": 24}, {"restart": True}):
        train(tiny(), tmp_path, restart=True)
        (tmp_path / "tensorboard").mkdir()
        restart = options.pop("restart", False)
        Run.open(tiny(**options), tmp_path, restart, (), Execution()).close()
        left = {path.name for path in tmp_path.iterdir()}
        assert not left & {"training_curve.png", "training.json"} and ("tensorboard" in left) is not restart


@pytest.mark.parametrize(("answer", "asked"), [(False, 1), (np.False_, 1), (0.0, 9), (None, 9)])
def test_a_callback_that_answers_no_ends_the_run_and_one_that_answers_a_figure_does_not(tmp_path, answer, asked):
    rows = []
    napsp.train("point_maze", out=tmp_path, episodes=40, on_evaluation=lambda row: rows.append(row) or answer,
                options={"n_warmup_episodes": 4, "n_policy_updates": 1, "n_temporal_updates": 1, "hidden": (8, 8),
                         "n_triangular_updates": 1, "evaluate.every": 4, "evaluate.n_episodes": 1})  # fmt: skip
    assert len(rows) == asked
