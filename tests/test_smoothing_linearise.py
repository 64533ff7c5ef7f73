"""Linearising the simulator around a plan: true sensitivities, the same to the bit however they are simulated."""

import copy

import numpy as np
import pytest

from mpc.rollout import RolloutEngine
from mpc.smoothing.linearise import linearise
from napsp.envs.dynamics import get_state


@pytest.mark.parametrize("env", ["point_maze", "fetch_reach"])
def test_linearisation_predicts_the_simulator(worlds, env):
    world, rng = worlds[env], np.random.default_rng(0)
    world.reset(seed=3)
    state, size = get_state(world.model, world.data), world.action_space.shape[0]
    actions = rng.uniform(-0.3, 0.3, (4, size)).astype(np.float32)
    with RolloutEngine(world.dynamics, 1) as engine:
        linear = linearise(engine, state, actions, 4, step=0.01)
        assert linear.sensitivities.shape == (4, world.observation_space["observation"].shape[0], 4 * size)
        for step in (0.1, -0.05):
            change = (step * rng.standard_normal(actions.shape)).astype(np.float32)
            moved = engine.rollout(state, (actions + change)[None]).observations[0]
            predicted = linear.nominal.observations[0] + linear.sensitivities @ change.ravel()
            error, size_of_change = moved - predicted, moved - linear.nominal.observations[0]
            assert np.linalg.norm(error[:, :2]) < 0.01 * np.linalg.norm(size_of_change[:, :2])
    # Actions do not reach back in time, and Fetch's blocked gripper (the last number) moves nothing.
    by_time = linear.sensitivities.reshape(4, -1, 4, size)
    assert not by_time[0, :, 1:].any() and by_time[3].any()
    assert env == "point_maze" or not by_time[..., 3].any()


@pytest.mark.parametrize("env", ["point_maze", "fetch_wall"])
def test_a_traced_plan_goes_on_from_any_of_its_states(worlds, env):
    world, rng = worlds[env], np.random.default_rng(1)
    world.reset(seed=4)
    state = get_state(world.model, world.data)
    actions = rng.uniform(-1, 1, (4, world.action_space.shape[0])).astype(np.float32)
    with RolloutEngine(world.dynamics, 1) as engine:
        whole = engine.rollout(state, actions[None])
        traced, states = engine.trace(state, actions)
        np.testing.assert_array_equal(traced.observations, whole.observations)
        np.testing.assert_array_equal(traced.achieved_goals, whole.achieved_goals)
        assert not traced.diverged.any() and len(states) == 4
        for t in range(4):  # to the bit: the linearisation simulates only what an action changes
            rest = engine.rollout(states[t], actions[None, t:])
            np.testing.assert_array_equal(rest.observations, whole.observations[:, t:])
            assert not rest.diverged.any()


@pytest.mark.parametrize("env", ["point_maze", "fetch_wall"])
def test_linearisation_does_not_depend_on_the_number_of_cores(worlds, env):
    world = worlds[env]
    world.reset(seed=5)
    state, size = get_state(world.model, world.data), world.action_space.shape[0]
    actions = np.random.default_rng(3).uniform(-1, 1, (5, size)).astype(np.float32)
    found = []
    for n_threads in (1, 64):  # step by step, and all copies in one batch
        with RolloutEngine(world.dynamics, n_threads, fork=False) as engine:
            batches, rollout = [], engine.rollout
            engine.rollout = lambda state, actions: (batches.append(len(actions)), rollout(state, actions))[1]  # noqa: B023
            linear = linearise(engine, state, actions, 4)
            assert len(batches) == (4 if n_threads == 1 else 1)
            found.append((linear.sensitivities, linear.nominal.observations))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_actions_that_move_nothing_are_not_simulated(worlds):
    world = worlds["point_maze"]
    world.reset(seed=3)
    dynamics = copy.copy(world.dynamics)
    dynamics.control = lambda actions: np.where(np.abs(actions) < 0.5, 0.0, actions).astype(float)  # a dead zone
    state, still = get_state(world.model, world.data), np.zeros((4, 2), np.float32)
    with RolloutEngine(dynamics, 1) as engine:
        assert not linearise(engine, state, still, 4).sensitivities.any()
        assert not linearise(engine, state, still, 0).sensitivities.size
        assert engine.rollout(state, np.zeros((0, 4, 2), np.float32)).observations.shape[:2] == (0, 4)
