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

from napsp.config import ADDED, METHODS, RANGES, TrainConfig, from_dict
from napsp.errors import UserError
from napsp.presets import preset
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
    "evaluate_every": 4,
    "n_evaluation_episodes": 2,
}


def tiny(env="point_maze", **changes):
    return preset(env, **{**TINY, **changes})


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
    train(tiny(slow_distance=slow, target_polyak=0.1), tmp_path)
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
    "changes", [{}, {"agent": "ddpg", "rescale": True, "clipped_double_q": True, "slow_distance": True}]
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
    for name, value in tiny(n_episodes=4000).to_dict().items():
        if name in TINY:
            values = [str(v) for v in value] if isinstance(value, list) else [str(value)]
            command += [f"--{name.replace('_', '-')}", *values]
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
    for table in ("visits", "reached"):
        assert often[f"{table}.counts"].sum() == once[f"{table}.counts"].sum()
    assert not torch.equal(often["policy.scaling.goal_scale"], once["policy.scaling.goal_scale"])


def test_reduced_precision_is_for_the_training_alone(tmp_path):
    assert tiny().hash() == TrainConfig(**{**tiny().to_dict(), "matmul_precision": "highest"}).hash()
    assert tiny().hash() != tiny(matmul_precision="medium").hash()
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
    with pytest.raises(UserError, match="other settings \\(discount\\)"):
        train(tiny(discount=0.9), tmp_path)
    assert len(train(tiny(discount=0.9), tmp_path, restart=True)) == 3


def test_a_run_begun_before_an_option_existed_is_continued(tmp_path):
    train(tiny(n_episodes=8), tmp_path)
    tensors, header = read_tensors(tmp_path / STATE_FILE, "training state")
    header["config"] = {name: value for name, value in header["config"].items() if name not in ADDED}
    write_tensors(tmp_path / STATE_FILE, tensors, header)
    assert train(tiny(), tmp_path)[-1]["episodes"] == tiny().n_episodes


def test_a_state_whose_distance_had_made_no_step_is_continued(tmp_path):
    """Older versions did not store an optimiser before its first step."""
    train(tiny(method="sparse", n_episodes=8), tmp_path)
    tensors, header = read_tensors(tmp_path / STATE_FILE, "training state")
    old = {name: value for name, value in tensors.items() if not name.startswith("distance_optimizer.")}
    write_tensors(tmp_path / STATE_FILE, old, header)
    continued = train(tiny(method="sparse"), tmp_path)
    assert str(learned(continued)) == str(learned(train(tiny(method="sparse"), tmp_path / "whole")))  # NaN and all


def test_compiling_changes_neither_the_hash_nor_whose_run_it_is(tmp_path):
    assert tiny(compiled=True).hash() == tiny().hash()
    train(tiny(n_episodes=8), tmp_path)
    read_training(tmp_path / STATE_FILE, tiny(compiled=True))


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
    config, options = parse(["--env", "point_maze_long", "--seed", "7", "--method", "ddl"])
    assert config == preset("point_maze_long", seed=7, method="ddl") and options.out is None
    assert parse(["--env=fetch_reach_wall"])[0].env == "fetch_wall"
    for method, discount in (("ours", 0.9), ("sparse", 0.98)):
        config = parse(["--env", "fetch_pick_place", f"--method={method}"])[0]
        assert config == preset("fetch_pick_place", method=method) and config.discount == discount


def test_bad_settings_name_the_fix():
    for changes, words in (
        ({"method": "magic"}, "choose one of: sparse, ddl, offpolicy_ddl, ours"),
        ({"agent": "td3"}, "choose one of: sac, ddpg"),
        ({"batch_size": 0}, "batch_size is 0; it must lie between 1"),
        ({"uncertainty_scale": 0.0}, "uncertainty_scale is 0.0"),
        ({"visit_bits": 99}, "between 1 and 62"),
        ({"seed": -1}, "seed is -1"),
        ({"discount": 1.0}, "discount is 1.0"),
        ({"epsilon": float("nan")}, "epsilon is nan"),
        ({"hidden": ()}, "at least one width"),
        ({"n_episodes": 4}, "must exceed the 4 warm-up episodes"),
    ):
        with pytest.raises(UserError, match=words):
            tiny(**changes)
    with pytest.raises(UserError, match="does not fit this version"):
        from_dict({**tiny().to_dict(), "colour": 1})


def test_every_number_has_a_range():
    numbers = {f.name for f in dataclasses.fields(TrainConfig) if "int" in str(f.type) or "float" in str(f.type)}
    assert numbers - {"hidden"} == set(RANGES)
    for name, (low, _) in RANGES.items():
        with pytest.raises(UserError, match=f"{name} is"):
            tiny(**{name: low - 1})


def test_hash_ignores_the_seed_only():
    assert tiny(seed=1).hash() == tiny(seed=2).hash() != tiny(discount=0.9).hash()
