"""Training end to end: it learns, it is deterministic, it survives being killed."""

import csv
import dataclasses
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

from napsp.config import METHODS, TrainConfig, from_dict, preset, to_dict
from napsp.distance.counts import CountModel
from napsp.envs.cards import CARDS
from napsp.errors import UserError
from napsp.execution import Execution
from napsp.learner import Learner
from napsp.renamed import TRAINING
from napsp.run import Run
from napsp.settings import as_flags, changed, flat
from napsp.storage.checkpoint import load_model
from napsp.storage.files import read_tensors, write_tensors
from napsp.storage.resume import STATE_FILE, read_training
from napsp.train import parse, train

TINY = {
    "n_episodes": 16,
    "n_warmup_episodes": 4,
    "episodes_per_iteration": 2,
    "n_temporal_updates": 3,
    "n_triangular_updates": 2,
    "n_policy_updates": 3,
    "batch_size": 32,
    "hidden": (16, 16),
    "evaluate.every": 4,
    "evaluate.n_episodes": 2,
}


def tiny(env="point_maze", method="ours", recipe="paper", **changes):
    return preset(env, method, recipe, {**TINY, **changes})


def learned(rows):
    """Rows without what depends on the clock."""
    clock = {"seconds", "steps_per_second", "minutes_left"}
    return [{k: v for k, v in row.items() if k not in clock} for row in rows]


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
    first, second = (read_tensors(tmp_path / name / STATE_FILE, "training state")[0] for name in ("whole", "parts"))
    assert first.keys() == second.keys()
    assert all(torch.equal(first[name], second[name]) for name in first)


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
    (often, header), (once, _) = (read_tensors(tmp_path / n / STATE_FILE, "training state") for n in ("often", "once"))
    assert header["scaled_at"] == 16
    for table in ("visits", "reached.0.table", "reached.2.table"):
        assert often[f"{table}.counts"].sum() == once[f"{table}.counts"].sum()
    assert not torch.equal(often["policy.scaling.goal_scale"], once["policy.scaling.goal_scale"])


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


def test_other_settings_in_the_same_folder_are_refused(tmp_path):
    train(tiny(), tmp_path)
    with pytest.raises(UserError, match=r"other settings \(policy\.discount\)"):
        train(tiny(**{"policy.discount": 0.9}), tmp_path)
    assert len(train(tiny(**{"policy.discount": 0.9}), tmp_path, restart=True)) == 3


def test_a_restart_that_cannot_be_leaves_what_there_is(tmp_path):
    train(tiny(n_episodes=8), tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(UserError, match="no box to hold"):
        train(tiny(n_episodes=8, **{"explore.held_starts": 0.5}), tmp_path, restart=True)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_finished_run_that_lost_its_rows_says_so(tmp_path):
    train(tiny(n_episodes=8), tmp_path)
    for name in ("metrics.csv", "training.json"):
        (tmp_path / name).unlink()
    with pytest.raises(UserError, match=r"has lost the metrics\.csv of its finished run; begin anew with --restart"):
        train(tiny(n_episodes=8), tmp_path)


def test_how_goals_are_counted_touches_nothing_that_does_not_ask(tmp_path):
    rows = [train(tiny(method="sparse", **{"counts.n_lattices": n}), tmp_path / str(n)) for n in (1, 3)]
    assert str(learned(rows[0])) == str(learned(rows[1]))
    assert not [name for name in read_tensors(tmp_path / "3" / STATE_FILE, "training state")[0] if "reached" in name]


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


def test_command_line_defaults_follow_the_task():
    config, options, execution = parse(["--env", "point_maze_long", "--seed", "7", "--method", "ddl"])
    assert config == preset("point_maze_long", "ddl", seed=7) and options.out is None and execution == Execution()
    assert parse([])[0] == preset("fetch_wall")
    assert parse(["--env=fetch_reach_wall"])[0].env == "fetch_wall"
    assert parse(["--episodes", "77"])[0].n_episodes == parse(["--n-episodes", "77"])[0].n_episodes == 77
    config = parse(["--env", "fetch_wall", "--counts.goal-cell", "0.5", "--distance.slow", "--hidden", "8", "9"])[0]
    assert config == preset("fetch_wall", changes={"counts.goal_cell": 0.5, "distance.slow": True}, hidden=(8, 9))


def test_ours_is_the_paper_on_every_task_and_a_recipe_is_named():
    for env in CARDS:
        config = preset(env)
        beyond = (config.distance.slow, config.temporal.first_arrival, config.policy.clipped_double_q)
        assert config.recipe == "paper" and not any(beyond) and config.her.other_goals_ratio == 0.0
        assert config.distance.target_polyak == 1.0 and config.explore.held_starts == 0.0
    for method, discount in (("ours", 0.9), ("sparse", 0.98)):
        config = parse(["--env", "fetch_pick_place", "--recipe", "manipulation", f"--method={method}"])[0]
        assert config == preset("fetch_pick_place", method, "manipulation") and config.policy.discount == discount
        assert config.explore.held_starts == 0.5 and config.distance.slow
    with pytest.raises(UserError, match="no recipe 'manipulation' for point_maze; choose one of: paper"):
        preset("point_maze", recipe="manipulation")


def test_old_flags_get_a_sentence_with_the_new_name(capsys):
    for old, new in (
        ("visit-bits", "counts.visit-bits"),
        ("first-arrival", "temporal.first-arrival"),
        ("reached-bits", "counts.pair-bits"),
    ):
        with pytest.raises(UserError, match=f"--{old} is now called --{new}"):
            parse(["--env", "point_maze", f"--{old}"])
    with pytest.raises(UserError, match=r"--no-cap-triangular is now called --triangular\.no-cap$"):
        parse(["--no-cap-triangular"])
    with pytest.raises(UserError, match=r"--epsilon is now called --explore\.epsilon, and is the share of"):
        parse(["--epsilon", "0.1"])
    with pytest.raises(UserError, match=r"--evaluate-every is now called --evaluate\.every"):
        parse(["--evaluate_every=5"])
    for new in TRAINING.values():
        assert new in flat(to_dict(preset("point_maze"))), f"{new} exists"


def test_bad_settings_name_the_fix():
    for changes, words in (
        ({"method": "magic"}, "choose one of: sparse, ddl, offpolicy_ddl, ours"),
        ({"distance.head": "mlq"}, "unknown head 'mlq'; choose one of: mlp, quasimetric"),
        ({"policy.agent": "td3"}, "unknown agent 'td3'; choose one of: sac, ddpg"),
        ({"distance.loss": "cubic"}, "unknown loss 'cubic'; choose one of: squared"),
        ({"batch_size": 0}, "batch_size is 0; it must lie between 1"),
        ({"uncertainty.scale": 0.0}, "scale is 0.0"),
        ({"counts.visit_bits": 99}, "visit_bits is 99; it must lie between 1 and 62"),
        ({"seed": -1}, "seed is -1"),
        ({"policy.discount": 1.0}, "discount is 1.0"),
        ({"explore.epsilon": float("nan")}, "epsilon is nan"),
        ({"her.relabel_ratio": 0.8, "her.other_goals_ratio": 0.3}, "exceed 1 together"),
        ({"hidden": ()}, "at least one width"),
        ({"n_episodes": 4}, "must exceed the 4 warm-up episodes"),
        ({"counts.colour": 1}, "there is no option 'colour' in CountConfig"),
        ({"colour": 1}, "there is no option 'colour' in TrainConfig"),
    ):
        with pytest.raises(UserError, match=words):
            tiny(**changes)
    with pytest.raises(UserError, match="does not fit this version"):
        from_dict({**to_dict(tiny()), "colour": 1})


def numbers(config, prefix=""):
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from numbers(value, f"{field.name}.")
        elif "int" in str(field.type).replace("tuple[int, ...]", "") or "float" in str(field.type):
            yield prefix + field.name


def test_every_number_has_a_range():
    for name in numbers(TrainConfig()):
        for value in (-1, float("nan")):
            with pytest.raises(UserError, match=f"{name.rpartition('.')[2]} is {value}"):
                changed(TrainConfig(), {name: value})


def test_the_identity_is_the_difference_from_the_defaults():
    assert preset("fetch_wall").identity() == {"env": "fetch_wall", "method": "ours"}
    changes = {"counts.goal_cell": 0.5, "hidden": (8, 8)}
    assert preset("fetch_wall", seed=3, changes=changes).identity() == {
        "env": "fetch_wall", "method": "ours", "counts.goal_cell": 0.5, "hidden": [8, 8],
    }  # fmt: skip
    fixed = [tiny(**{"policy.entropy_weight": weight}).digest() for weight in (1, 1.0, 2)]
    assert fixed[0] == fixed[1] != fixed[2]
    assert tiny(seed=1).digest() == tiny(seed=2).digest() != tiny(**{"policy.discount": 0.9}).digest()
    assert from_dict(to_dict(tiny())) == tiny()
    for method, asks in (("ours", True), ("offpolicy_ddl", False), ("sparse", False)):
        finer = preset("fetch_wall", method, changes={"counts.goal_cell": 0.5})
        assert (finer.identity() != preset("fetch_wall", method).identity()) is asks, "eq. 4b alone asks for N(s, a, g)"


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
