"""Training end to end: it learns, it is deterministic, it survives being killed."""

import csv
import json
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import torch
from tiny import TINY, content, fingerprint, learned, tiny

from napsp.config import METHODS
from napsp.distance.counts import CountModel
from napsp.errors import UserError
from napsp.learner import Learner
from napsp.run import Run
from napsp.settings import as_flags
from napsp.storage.checkpoint import load_model
from napsp.storage.files import read_tensors, write_tensors
from napsp.storage.resume import read_training
from napsp.storage.state import STATE_FILE
from napsp.train import parse, train


@pytest.mark.parametrize("method", METHODS)
def test_every_method_runs_and_writes_its_files(method, tmp_path, capsys):
    rows = train(tiny(method=method), tmp_path)
    assert [row["episodes"] for row in rows] == [8, 12, 16]
    assert "success" in capsys.readouterr().out
    with open(tmp_path / "metrics.csv", newline="") as file:
        assert len(list(csv.DictReader(file))) == 3
    model = load_model(tmp_path, "point_maze")
    assert (model.distance is None) == (method == "sparse")
    assert ("merging_rate" in rows[0]) == (method == "ours")
    record = json.loads((tmp_path / "training.json").read_text())
    assert parse(record["command"].split()[3:])[0] == tiny(method=method), "the recorded command repeats the run"
    assert (tmp_path / "training_curve.png").read_bytes()[:4] == b"\x89PNG"
    assert model.header["episodes"] == 16 and model.config.method == method


@pytest.mark.parametrize("slow", [False, True])
def test_the_slow_distance_is_the_one_saved_and_used(tmp_path, slow):
    train(tiny(**{"distance.slow": slow, "distance.target_polyak": 0.1}), tmp_path)
    state = read_tensors(tmp_path / STATE_FILE, "training state")[0]
    saved = load_model(tmp_path, "point_maze").distance.state_dict()
    same = {
        name: all(torch.equal(value, state[f"{name}.{key}"]) for key, value in saved.items())
        for name in ("distance", "target_distance")
    }
    assert same == {"distance": not slow, "target_distance": slow}


def test_same_seed_same_run(tmp_path):
    first, second = (train(tiny(seed=3), tmp_path / name) for name in ("a", "b"))
    assert learned(first) == learned(second)
    assert learned(train(tiny(seed=4), tmp_path / "c")) != learned(first)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"rescale": True},
        {"method": "sparse"},
        {"method": "ddl"},
        {"policy.agent": "ddpg", "rescale": True, "policy.clipped_double_q": True, "distance.slow": True},
    ],
)
def test_a_resumed_run_equals_an_uninterrupted_one(tmp_path, changes):
    whole = train(tiny(**changes), tmp_path / "whole")
    train(tiny(**changes, n_episodes=8), tmp_path / "parts")
    resumed = train(tiny(**changes), tmp_path / "parts")
    assert learned(resumed) == learned(whole)
    assert fingerprint(tmp_path / "parts") == fingerprint(tmp_path / "whole")


def test_killed_at_a_random_moment_it_continues(tmp_path):
    command = [sys.executable, "-m", "napsp.train", "--env", "point_maze", "--out", str(tmp_path / "run")]
    command += as_flags({**TINY, "n_episodes": 4000}).split()
    done = []
    for pause in np.random.default_rng(0).uniform(0.3, 1.5, 2):
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        state = tmp_path / "run" / STATE_FILE
        deadline = time.monotonic() + 60
        before = state.stat().st_mtime_ns if state.is_file() else 0
        while time.monotonic() < deadline and (not state.is_file() or state.stat().st_mtime_ns == before):
            time.sleep(0.05)
        time.sleep(pause)
        process.send_signal(signal.SIGKILL)
        output = process.communicate()[0]
        assert "Traceback" not in output
        header = read_tensors(state, "training state")[1]
        done.append(header["iteration"])
    assert "continuing" in output and done[1] > done[0] > 0
    with open(tmp_path / "run" / "metrics.csv", newline="") as file:
        episodes = [float(row["episodes"]) for row in csv.DictReader(file)]
    assert episodes == sorted(set(episodes)), "a resumed run must not repeat rows"


def test_rescaling_counts_everything_again(tmp_path):
    train(tiny(rescale=True), tmp_path / "often")
    train(tiny(), tmp_path / "once")
    assert read_tensors(tmp_path / "often" / STATE_FILE, "training state")[1]["scaled_at"] == 16
    often, once = (content(tmp_path / name) for name in ("often", "once"))
    for table in ("visits", "reached.0.table", "reached.2.table"):
        assert often[f"{table}.counts"].sum() == once[f"{table}.counts"].sum()
    assert (often["policy.scaling.goal_scale"] != once["policy.scaling.goal_scale"]).any()


def test_reduced_precision_is_for_the_training_alone(tmp_path):
    assert tiny().digest() != tiny(matmul_precision="medium").digest()
    rough = train(tiny(matmul_precision="medium"), tmp_path / "rough")
    assert torch.get_float32_matmul_precision() == "highest"
    assert learned(train(tiny(matmul_precision="medium"), tmp_path / "again")) == learned(rough)


def test_interrupt_saves_and_the_same_command_goes_on(tmp_path, capsys):
    config = tiny(n_episodes=4000)

    def interrupt_once_it_works():
        while not (tmp_path / "metrics.csv").is_file():
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    killer = threading.Thread(target=interrupt_once_it_works)
    killer.start()
    train(config, tmp_path)
    killer.join()
    assert not (tmp_path / "training.json").exists(), "an interrupted run has no record"
    assert "the same command continues it" in capsys.readouterr().out
    assert read_tensors(tmp_path / STATE_FILE, "training state")[1]["iteration"] > 0


@pytest.mark.parametrize(("before", "words"), [(0, "begins anew"), (8, "continues from the last save")])
def test_ctrl_c_before_the_first_iteration_says_that_nothing_was_saved(before, words, tmp_path, monkeypatch, capsys):
    if before:
        train(tiny(n_episodes=before), tmp_path / "run")

    def interrupted(*arguments):
        raise KeyboardInterrupt  # what Ctrl-C is there: nothing listens yet

    monkeypatch.setattr("napsp.run.warm_up" if not before else "napsp.run.restore_training", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train(tiny(), tmp_path / "run")
    assert f"nothing was saved in {tmp_path / 'run'} this time; the same command {words}" in capsys.readouterr().out


def test_training_works_in_a_thread_and_leaves_ctrl_c_alone(tmp_path):
    rows, handler = [], signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=lambda: rows.extend(train(tiny(n_episodes=8), tmp_path)))
    thread.start()
    while thread.is_alive():
        assert signal.getsignal(signal.SIGINT) is handler
        thread.join(0.05)
    assert rows[-1]["episodes"] == 8 and (tmp_path / "training_curve.png").is_file()


def test_a_run_is_not_continued_with_episodes_of_another_length(tmp_path, monkeypatch):
    train(tiny(n_episodes=8), tmp_path)
    monkeypatch.setattr("napsp.config.episode_length", lambda env: 20)
    with pytest.raises(UserError, match="episodes of 50 steps, and point_maze has 20 now; put its time limit back"):
        train(tiny(), tmp_path)


def test_a_model_without_the_state_of_its_training_is_not_replaced(tmp_path):
    train(tiny(n_episodes=8), tmp_path)
    (tmp_path / STATE_FILE).unlink()
    with pytest.raises(UserError, match="holds a model and not the state of its training"):
        train(tiny(), tmp_path)
    assert train(tiny(), tmp_path, restart=True)[-1]["episodes"] == 16


def test_other_settings_in_the_same_folder_are_refused(tmp_path):
    train(tiny(), tmp_path)
    with pytest.raises(UserError, match=r"other settings \(policy\.discount\)"):
        train(tiny(**{"policy.discount": 0.9}), tmp_path)
    assert len(train(tiny(**{"policy.discount": 0.9}), tmp_path, restart=True)) == 3


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_restart_that_cannot_be_leaves_what_there_is(tmp_path):
    train(tiny(n_episodes=8), tmp_path)
    before = contents(tmp_path)
    with pytest.raises(UserError, match="no box to hold"):
        train(tiny(n_episodes=8, **{"explore.held_starts": 0.5}), tmp_path, restart=True)
    assert contents(tmp_path) == before and len(before) > 3


def test_a_finished_run_that_lost_its_rows_says_so(tmp_path):
    train(tiny(n_episodes=8), tmp_path)
    for name in ("metrics.csv", "training.json"):
        (tmp_path / name).unlink()
    with pytest.raises(UserError, match=r"has lost the metrics\.csv of its finished run; begin anew with --restart"):
        train(tiny(n_episodes=8), tmp_path)


def test_how_goals_are_counted_touches_nothing_that_does_not_ask(tmp_path):
    rows = [train(tiny(method="sparse", **{"counts.n_lattices": n}), tmp_path / str(n)) for n in (1, 3)]
    assert str(learned(rows[0])) == str(learned(rows[1]))
    assert not [name for name in content(tmp_path / "3") if "reached" in name]


def test_a_run_begun_before_an_option_existed_is_continued(tmp_path):
    train(tiny(n_episodes=8), tmp_path)
    tensors, header = read_tensors(tmp_path / STATE_FILE, "training state")
    del header["config"]["counts"]["n_lattices"], header["config"]["matmul_precision"]
    write_tensors(tmp_path / STATE_FILE, tensors, header)
    assert train(tiny(), tmp_path)[-1]["episodes"] == tiny().n_episodes


def test_a_state_of_an_older_format_is_one_sentence(tmp_path):
    train(tiny(n_episodes=8), tmp_path)
    tensors, header = read_tensors(tmp_path / STATE_FILE, "training state")
    write_tensors(tmp_path / STATE_FILE, tensors, {**header, "format": "napsp-1"})
    with pytest.raises(UserError, match=r"older version of napsp.* or begin anew with --restart"):
        read_training(tmp_path / STATE_FILE, tiny())


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="a compiler made of a shell script")
def test_a_compiler_that_fails_is_one_sentence(tmp_path):
    (tmp_path / "g++").write_text("#!/bin/sh\nexit 1\n")
    (tmp_path / "g++").chmod(0o755)
    surroundings = {k: v for k, v in os.environ.items() if k != "CXX"}
    surroundings |= {"PATH": f"{tmp_path}:{os.environ['PATH']}", "TORCHINDUCTOR_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-m", "napsp.train", "--env", "point_maze", "--compiled", "--n-warmup-episodes", "4"]
    done = subprocess.run([*command, "--out", str(tmp_path / "run")], env=surroundings, capture_output=True, text=True)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "compiling the updates failed" in done.stderr and "leave --compiled out" in done.stderr


def test_the_loop_is_algorithm_1(tmp_path, monkeypatch):
    """The order of the lines, what each is handed, and that D_last joins D at the end."""
    calls = []

    def recording(owner, name):
        function = getattr(owner, name)

        def call(self, *arguments):
            size = len(self.buffer) if isinstance(self, Learner) else None
            calls.append((name, arguments[0] if arguments else None, size))
            return function(self, *arguments)

        monkeypatch.setattr(owner, name, call)

    for name in ("train_temporal", "update_target", "train_triangular", "train_policy", "extend_buffer"):
        recording(Learner, name)
    recording(CountModel, "update")
    recording(Run, "collect")
    train(tiny(n_episodes=8), tmp_path)
    names = [name for name, *_ in calls]
    iteration = ["collect", "update", "train_temporal", "update_target", "train_triangular", "train_policy"]
    assert names == ["update", *[*iteration, "extend_buffer"] * 2], "the first counts the warm-up"
    for first in (1, 8):
        recent = [argument for name, argument, _ in calls[first + 1 : first + 7] if argument is not None]
        assert all(argument is recent[0] for argument in recent) and len(recent) == 4 and len(recent[0]) == 2
    assert {size for *_, size in calls[3:8] if size is not None} == {4}
    assert {size for *_, size in calls[10:15] if size is not None} == {6}


def test_methods_leave_out_the_lines_they_lack(tmp_path, monkeypatch):
    done = []
    for name in ("train_temporal", "update_target", "train_triangular"):
        monkeypatch.setattr(Learner, name, lambda self, *_, name=name: done.append(name) or {})
    for method, lines in (
        ("sparse", []),
        ("ddl", ["train_temporal", "update_target"]),
        ("offpolicy_ddl", ["train_temporal", "update_target"]),
        ("ours", ["train_temporal", "update_target", "train_triangular"]),
    ):
        done.clear()
        train(tiny(method=method, n_episodes=6), tmp_path / method)
        assert done == lines
