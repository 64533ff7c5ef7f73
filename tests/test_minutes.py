"""Times of training beside Stable-Baselines3: both are asked the same, and runs end at enough success or too late."""

import itertools

import numpy as np
import pytest
from tiny import tiny

from benchmarks import minutes, tables_minutes
from benchmarks.machine import processor
from napsp import envs
from napsp.data.outcomes import evaluate
from napsp.policy.greedy import GreedyPolicy
from napsp.run import EVALUATION_SEED
from napsp.storage.checkpoint import load_model
from napsp.storage.shipped import shipped_model


def test_a_run_ends_when_enough_is_held_or_its_minutes_are_up(monkeypatch):
    clock = itertools.count(30.0, 30.0)
    monkeypatch.setattr(minutes.time, "process_time", lambda: next(clock))
    watched = minutes.Watched(10.0, began=0.0)
    assert watched(25, 0.2) and not watched(50, 0.9)
    assert watched.figures() == {
        "reached": 1, "episodes": 50, "minutes": 1.0, "success_rate": 0.9, "budget": 10.0,
        "evaluations": "25:0.2:0.50 50:0.9:1.00"
    }  # fmt: skip
    late = minutes.Watched(0.9, began=60.0)
    assert late(25, 0.2) and not late(50, 0.85)
    assert late.figures()["reached"] == 0


def test_goals_are_held_as_in_the_evaluations_of_training():
    """The policy that ships holds some of the goals after 20 steps, and not all."""
    env, model = envs.make("point_maze"), load_model(shipped_model("point_maze"), "point_maze")
    policy, seeds = GreedyPolicy(model.policy), [EVALUATION_SEED + i for i in range(6)]
    expected = evaluate([env], policy, seeds, 20)[0].reached[:, -1]
    own = [
        minutes.holds(env, lambda seen: policy(seen["observation"][None], seen["desired_goal"][None])[0], seed, 20)
        for seed in seeds
    ]
    assert 0 < sum(own) < 6
    np.testing.assert_array_equal(own, expected)


def test_stable_baselines3_is_trained_with_its_settings_and_asked_after_so_many_episodes(monkeypatch):
    """Normalised by what it trains on alone; what it is asked does not enter its statistics."""
    told, asked = [], []
    settings = minutes.Published(32, (16, 16), 1000, learning_starts=60, normalize=True)

    def answered(env, act, seed, length):
        observation, _ = env.reset(seed=seed)
        asked.append((act(observation), observation))
        return seed == EVALUATION_SEED

    def watch(episodes, success):
        told.append((episodes, success))
        return len(told) < 2

    monkeypatch.setattr(minutes, "holds", answered)
    model = minutes.run_peer("fetch_reach", settings, 2, 4, 0, watch, lambda: False)
    assert told == [(2, 0.25), (4, 0.25)]
    assert model.num_timesteps == 200 and model._n_updates == 200 - 60
    assert (model.batch_size, model.gamma, model.tau, model.learning_rate) == (32, 0.95, 0.005, 1e-3)
    seen = model.get_vec_normalize_env().obs_rms["observation"]
    assert seen.count == pytest.approx(201, abs=0.01)  # one reset more than steps, nothing of the eight evaluations
    action, observation = asked[-1]
    rows = model.get_vec_normalize_env().normalize_obs({name: value[None] for name, value in observation.items()})
    np.testing.assert_array_equal(action, model.predict(rows, deterministic=True)[0][0])


def test_stable_baselines3_is_asked_once_more_where_its_minutes_end_between_evaluations(monkeypatch):
    told, steps = [], itertools.count(1)
    monkeypatch.setattr(minutes, "holds", lambda *_: True)

    def watch(episodes, success):
        told.append((episodes, success))
        return False

    settings = minutes.Published(32, (16, 16), 1000, learning_starts=60)
    model = minutes.run_peer("fetch_reach", settings, 9, 2, 0, watch, lambda: next(steps) >= 120)
    assert told == [(2, 1.0)] and model.num_timesteps == 120


@pytest.mark.filterwarnings("ignore:method sparse .* does not read")  # of a training made small
def test_rows_stand_in_the_table_and_are_measured_once(tmp_path, monkeypatch):
    monkeypatch.setattr(minutes, "FILE", tmp_path / "minutes.csv")
    monkeypatch.setattr(minutes, "preset", lambda env, method, recipe, seed=0: tiny(env, method, seed=seed))
    monkeypatch.setattr("napsp.library.preset", lambda env, method, *_, seed: tiny(env, method, seed=seed))
    row = minutes.run_cell("point_maze", "sparse", minutes.MinutesOptions(minutes=1e-6))
    assert row["reached"] == "0" and row["episodes"] == "8" and "8:0:" in row["evaluations"]
    assert minutes.run_cell("point_maze", "sparse", minutes.MinutesOptions(minutes=1e-7)) == row
    shown = "\n".join(tables_minutes.minutes_table())
    assert (
        f"\n| point_maze | {processor()} | sparse | 1 | never in 8 (success at most 0.00) | given up after 0 |\n"
        in shown
    )
    assert "\n| claw | not run | | | | |" in shown
    told = {"success_rate": "0.9", "reached": "1", "minutes": "2"}
    three = [row, row | told | {"episodes": "300"}, row | told | {"episodes": "100", "minutes": "0.5"}]
    assert tables_minutes._cells(three) == [
        "200 (100 to 300), 1 of 3 never in 8 (success at most 0.00)", "1.25 (0.50 to 2.00), 1 of 3 given up after 0"
    ]  # fmt: skip
    asked = {name: row[name] for name in minutes.KEY}
    assert minutes.answer([row], asked, 1.0) is None, "who asks for more minutes gets a run of as many"
    assert minutes.answer([row | {"reached": "1"}], asked, 1.0), "one that held enough needs no more"
    assert minutes.answer([row], asked | {"settings": "{}"}) is None
    assert minutes.answer([row], asked | {"processor": "another"}) is None, "minutes of another machine do not answer"
    assert minutes.Published.of("fetch_pick_place").batch_size == 1024 and minutes.Published.of("fetch_wall").normalize


def test_a_row_names_the_processor_and_its_units_for_bfloat16(tmp_path):
    told = tmp_path / "cpuinfo"
    told.write_text("processor\t: 0\nmodel name\t: Some CPU: 9 of it\nflags\t\t: fpu amx_bf16 avx2\n\n")
    assert processor(told) == "Some CPU: 9 of it with AMX"
    told.write_text("model name\t: Some CPU\nflags\t\t: fpu avx512_bf16\n")
    assert processor(told) == "Some CPU"
    assert processor(tmp_path / "none") and processor()
