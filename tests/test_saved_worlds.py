"""Environments that save and restore their state are simulated as they step, or one sentence says where not."""

import pickle
import warnings

import numpy as np
import pytest
from savers import FULL, Plane

import napsp
from mpc.rollout import RolloutEngine
from mpc.smoothing.linearise import linearise
from mpc.verify import verify
from mpc.workers import CAN_FORK
from napsp import envs
from napsp.data.collect import roll
from napsp.envs.goal_task import GoalTask, make_goal_task
from napsp.envs.saved_task import SavedTask
from napsp.errors import UserError

WORKERS = [(1, False), (2, False), (2, CAN_FORK)]
RIGHT = np.array([1.0, 0.0], np.float32)


def task(name, **kwargs):
    return envs.make(f"savers:{name}", **kwargs)


def planned(env, actions, n_threads=1, fork=False):
    """What plans ``(N, H, 2)`` lead to from where ``env`` is."""
    world = env.unwrapped
    with RolloutEngine(world.dynamics, n_threads, fork) as engine:
        return engine.rollout(engine.state_of(world), actions)


def plans(n, horizon, seed=0):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (n, horizon, 2)).astype(np.float32)


def tried(name, n_threads=2, fork=False):
    env = task(name)
    with RolloutEngine(env.unwrapped.dynamics, n_threads, fork) as engine:
        return verify(env, engine, name)


@pytest.mark.parametrize(("n_threads", "fork"), WORKERS)
@pytest.mark.parametrize("name", ["Plane", "Noisy", "Heavy", "Arriving", "Pit"])
def test_plans_of_an_environment_that_saves_its_state_come_true(name, n_threads, fork):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = tried(name, n_threads, fork)
    assert found.difference is None and found.touched is None and found.n_steps >= 8
    assert str(found).endswith(f"came as planned, to the bit ({found.path})")


@pytest.mark.parametrize("name", ["Plane", "Noisy", "Heavy", "Arriving", "Pit"])
def test_results_do_not_depend_on_workers(name):
    env, actions = task(name), plans(12, 9)
    env.reset(seed=3)
    env.step(RIGHT)
    found = [planned(env, actions, *workers) for workers in WORKERS]
    for other in found[1:]:
        for part in ("observations", "achieved_goals", "diverged"):
            np.testing.assert_array_equal(getattr(other, part), getattr(found[0], part))


def test_planning_leaves_the_environment_as_it_is():
    env, other = task("Noisy"), task("Noisy")
    for each in (env, other):
        each.reset(seed=5)
    for action in plans(1, 6)[0]:
        before = pickle.dumps(env.unwrapped.env.get_state())
        planned(env, plans(4, 5, seed=1), 2)
        assert pickle.dumps(env.unwrapped.env.get_state()) == before
        np.testing.assert_array_equal(env.step(action)[0]["observation"], other.step(action)[0]["observation"])


@pytest.mark.parametrize(
    ("name", "advice"),
    [("Forgetful", "get_state and set_state hold all"), ("Chancy", "its random generator"), ("Slippery", "seed 1")],
)
def test_a_state_that_leaves_something_out_is_warned_of(name, advice):
    with pytest.warns(RuntimeWarning, match=rf"{name}: a planned step differs from step\(\) .*{advice}"):
        assert tried(name).difference is not None


def test_a_state_without_the_goal_is_warned_of():
    with pytest.warns(RuntimeWarning, match=r"Aimless: after set_state\(state\) the desired goal is another"):
        task("Aimless")


def test_an_arrival_ends_a_plan_and_a_crash_makes_it_impossible():
    for name, crashes in (("Arriving", False), ("Pit", True)):
        env = task(name)
        env.reset(seed=0)
        straight = env.unwrapped.goal - env.unwrapped.env.place
        action = (straight / np.abs(straight).max()).astype(np.float32)
        found = planned(env, np.stack([np.tile(action, (12, 1)), np.zeros((12, 2), np.float32)]))
        assert found.diverged.tolist() == [crashes, False]
        rows, terminated = [], False
        while not terminated:
            observation, _, terminated, _, _ = env.step(action)
            rows.append(observation["achieved_goal"])
        assert 2 < len(rows) < 12
        np.testing.assert_array_equal(found.achieved_goals[0], rows + [rows[-1]] * (12 - len(rows)))


@pytest.mark.parametrize("name", ["Heavy", "Arriving"])
def test_a_traced_plan_goes_on_from_each_of_its_states(name):
    env = task(name)
    env.reset(seed=0)
    actions = np.tile(RIGHT, (10, 1))  # Arriving is there before its end
    with RolloutEngine(env.unwrapped.dynamics, 1) as engine:
        traced, states = engine.trace(engine.state_of(env.unwrapped), actions)
        for t, state in enumerate(states):
            rest = engine.rollout(state, actions[None, t:])
            np.testing.assert_array_equal(rest.observations[0], traced.observations[0, t:])
        followed = engine.follow(states[0], env.unwrapped.env.observe(), lambda o, g: RIGHT[None], 10)
    np.testing.assert_array_equal(engine.dynamics.observe(followed.features)[0], traced.observations[0])


@pytest.mark.parametrize("n_threads", [1, 2])
def test_the_linear_model_of_a_plan_is_that_of_the_world(n_threads):
    env = task("Plane")
    env.reset(seed=0)
    with RolloutEngine(env.unwrapped.dynamics, n_threads, fork=False) as engine:
        state = engine.state_of(env.unwrapped)
        found = linearise(engine, state, np.full((4, 2), 0.25, np.float32), 4).sensitivities
    for t in range(4):
        expected = np.hstack([np.eye(2) * FULL * (k <= t) for k in range(4)])
        np.testing.assert_allclose(found[t, :2], expected, atol=1e-5)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("Silent", r"lacks dynamics, model, .*, so add get_state as docs/goal_environments.md shows"),
        ("Broken", r"set_state\(state\) of savers:Broken failed with KeyError: 'speed'"),
        ("Entangled", r"get_state\(\) of savers:Entangled failed with .*let it return what pickle can copy"),
        ("Dense", r"compute_reward of savers:Dense is dense .*--reached RADIUS"),
        ("halved", "savers:halved is wrapped in Halved, which plans would not pass through"),
    ],
)
def test_what_can_not_be_planned_in_is_said_in_a_sentence(name, sentence):
    with pytest.raises(UserError, match=sentence):
        task(name)


def test_wrappers_that_look_on_stay():
    env = task("counted")
    env.reset(seed=0)
    assert "RecordEpisodeStatistics" in str(env) and isinstance(env.unwrapped, SavedTask)
    assert not planned(env, plans(2, 3)).diverged.any()


def test_a_success_test_by_radius_serves_dense_rewards_and_no_task_that_has_its_own():
    world = task("Dense", reached="0.3").unwrapped
    assert world.goal_radius == 0.3
    assert world.reached(np.array([[0.2, 0.0], [0.4, 0.0]]), np.zeros(2)).tolist() == [True, False]
    with pytest.raises(UserError, match="point_maze has a success test of its own"):
        envs.make("point_maze", reached="0.3")


def test_a_step_is_as_long_as_the_world_lets_it():
    assert task("Plane").unwrapped.step_length == pytest.approx(np.sqrt(2.0) * FULL, rel=1e-6)
    with pytest.raises(UserError, match="give its class the attribute step_length"):
        _ = task("Still").unwrapped.step_length


def test_training_sees_what_it_saw_without_the_two_methods():
    with_both, without = make_goal_task("savers:Plane"), make_goal_task("savers:Silent")
    assert type(with_both.env) is GoalTask and isinstance(with_both.unwrapped, Plane)
    one, other = (roll([env], lambda s, g: np.tanh(3.0 * s[:, :2]) - 0.2, [0], 25) for env in (with_both, without))
    for part in ("observations", "actions", "achieved_goals"):
        np.testing.assert_array_equal(getattr(one, part), getattr(other, part))


def test_the_library_makes_what_can_be_planned_in():
    assert isinstance(napsp.make("savers:Plane").unwrapped, SavedTask)
    assert isinstance(napsp.make("savers:halved").unwrapped, Plane)
