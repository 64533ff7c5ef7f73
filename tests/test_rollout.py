"""Planned and executed trajectories are the same numbers, to the last bit."""

import itertools

import mujoco
import numpy as np
import pytest
from conftest import TASKS
from explosive import Explosive
from scripted import play

from mpc.rollout import RolloutEngine
from mpc.workers import CAN_FORK
from napsp.envs.dynamics import INTEGRATION_STATE, get_state
from napsp.envs.lean import lean

STEPS = 25
PICK_PLACE = ("fetch_pick_place", "fetch_pick_place_wall")


def start_episode(world, seed, contact):
    """Reset and move a little; the contact-rich kind leans on table, wall or maze walls."""
    rng = np.random.default_rng(seed)
    world.reset(seed=seed)
    shape = (STEPS, *world.action_space.shape)
    actions = rng.uniform(-1, 1, shape).astype(np.float32)
    if contact:
        push = np.zeros(shape[1:], np.float32)
        push[: min(3, len(push))] = [0.1, 0.5, -1.0][: min(3, len(push))]
        actions = 0.3 * actions + push
        for _ in range(15 * int(getattr(world, "scale", 1))):
            world.step(push)
    return actions.astype(np.float32)


def execute(world, actions):
    rows = [world.step(action)[0] for action in actions]
    return tuple(np.array([row[key] for row in rows]) for key in ("observation", "achieved_goal"))


def final_state(engine):
    data = engine.simulators[0].data
    return np.concatenate([data.qpos, data.qvel])


def start_grasp(world, seed, lift):
    """Grasp the box; return the actions that then carry it, or push it into the wall."""
    actions = play(world, seed, lift)[0]
    world.reset(seed=seed)
    for action in actions[:14]:
        world.step(action)
    actions = actions[14 : 14 + STEPS]
    if seed % 2:
        actions[:, 3] *= 0.01  # a full close saturates; now the fingers' targets follow the fingers
    return actions


def planned_in(world):
    """The dynamics that planners simulate: the environment's without what only pictures show."""
    return lean(world.dynamics, world.model_spec, world.action_space.shape[0])


def compare(world, engine, actions):
    """Largest difference between planned and executed numbers; executes the actions."""
    state = get_state(world.model, world.data)
    trajectories = engine.rollout(state, np.stack([actions[::-1], actions, actions]))
    with RolloutEngine(engine.dynamics, 1) as alone:
        alone.rollout(state, actions[None])
    assert not trajectories.diverged.any()
    observations, achieved = execute(world, actions)
    worst = max(
        np.abs(observations - trajectories.observations[1:]).max(),
        np.abs(achieved - trajectories.achieved_goals[1:]).max(),
    )
    if not world.dynamics.open_loop:
        executed = np.concatenate([world.data.qpos, world.data.qvel])
        worst = max(worst, np.abs(executed - final_state(alone)).max())
    return worst


@pytest.mark.parametrize("contact", [False, True], ids=["random", "contact"])
@pytest.mark.parametrize("name", TASKS)
def test_rollout_equals_step(name, contact, worlds):
    world, contacts = worlds[name], 0
    with RolloutEngine(world.dynamics, 2) as engine, RolloutEngine(planned_in(world), 2) as lean_engine:
        for seed in range(20):
            actions = start_episode(world, seed, contact)
            assert compare(world, lean_engine if seed % 2 else engine, actions) == 0.0
            contacts += world.data.ncon
    assert not contact or contacts >= 10, "the contact-rich episodes touch nothing"


@pytest.mark.parametrize("lift", [True, False], ids=["carry", "push"])
@pytest.mark.parametrize("name", PICK_PLACE)
def test_rollout_equals_step_while_grasping(name, lift, worlds):
    world = worlds[name]
    fingers = {world.model.geom(f"robot0:{side}_gripper_finger_link").id for side in "lr"}
    box, touched = world.model.geom("object0").id, 0
    with RolloutEngine(world.dynamics, 2) as engine, RolloutEngine(planned_in(world), 2) as lean_engine:
        for seed in range(10):
            actions = start_grasp(world, seed, lift)
            touched += any(box in pair and fingers & set(pair) for pair in world.data.contact.geom.tolist())
            assert compare(world, lean_engine if seed // 2 % 2 else engine, actions) == 0.0
    assert touched >= 8, "the gripper does not hold the box"


def without_warm_start(simulation):
    after_restore(simulation, lambda data: data.qacc_warmstart.fill(0.0))


def without_velocities(simulation):
    after_restore(simulation, lambda data: data.qvel.fill(0.0))


def without_box_velocity(simulation):
    after_restore(simulation, lambda data: data.qvel[-6:].fill(0.0))


def after_restore(simulation, forget):
    restore = simulation.restore

    def broken(state):
        restore(state)
        forget(simulation._data)

    simulation.restore = broken


def without_fresh_poses(simulation):
    model, data = simulation._model, simulation._data
    simulation.restore = lambda state: mujoco.mj_setState(model, data, state, INTEGRATION_STATE)


def without_finger_control(simulation):
    """Blocked fingers are not closed; driven ones get absolute targets."""
    simulation._fingers = simulation._actuated = np.zeros(2)


def with_swapped_fingers(simulation):
    simulation._actuated = simulation._fingers


def without_mocap_anchor(simulation):
    """Accumulates displacements on the mocap's own pose instead of the gripper's."""
    simulation._anchor = simulation._target


def without_mocap_rotation(simulation):
    simulation._rotation = np.array([1.0, 0.0, 0.0, 0.0])


ARM = (
    without_warm_start,
    without_velocities,
    without_fresh_poses,
    without_finger_control,
    without_mocap_anchor,
    without_mocap_rotation,
)
BREAKAGES = [("fetch_wall", f) for f in ARM]
BREAKAGES += [("fetch_pick_place_wall", f) for f in (*ARM, without_box_velocity, with_swapped_fingers)]


@pytest.mark.parametrize(("name", "breakage"), BREAKAGES)
def test_the_comparison_notices_missing_state(name, breakage, worlds):
    world = worlds[name]
    with RolloutEngine(world.dynamics, n_threads=2) as engine:
        for simulator in engine.simulators:
            breakage(simulator.simulation)
        worst = 0.0
        for seed in range(4):
            free = seed % 2 or name == "fetch_wall"
            actions = start_episode(world, seed, True) if free else start_grasp(world, seed, True)
            worst = max(worst, compare(world, engine, actions))
    assert worst > 0.0


def test_missing_warm_start_is_noticed_in_the_maze(worlds):
    world = worlds["point_maze"]
    worst = 0.0
    with RolloutEngine(world.dynamics, n_threads=2) as engine:
        for seed in range(20):
            actions = start_episode(world, seed, contact=True)
            state = get_state(world.model, world.data)
            data = mujoco.MjData(world.model)
            mujoco.mj_setState(world.model, data, state, INTEGRATION_STATE)
            data.qacc_warmstart[:] = 0.0
            trajectories = engine.rollout(get_state(world.model, data), actions[None])
            worst = max(worst, np.abs(execute(world, actions)[0] - trajectories.observations[0]).max())
    assert worst > 0.0


@pytest.mark.parametrize("name", ["point_maze", "fetch_wall", "fetch_pick_place", "claw"])
def test_results_do_not_depend_on_threads(name, worlds):
    world = worlds[name]
    world.reset(seed=0)
    state = get_state(world.model, world.data)
    actions = np.random.default_rng(0).uniform(-1, 1, (7, 10, world.action_space.shape[0])).astype(np.float32)
    results = []
    for n_threads, fork in itertools.product((1, 2, 3), (False, CAN_FORK)):
        with RolloutEngine(world.dynamics, n_threads, fork) as engine:
            results.append(engine.rollout(state, actions).observations)
    for result in results[1:]:
        np.testing.assert_array_equal(results[0], result)


@pytest.mark.parametrize("name", ["point_maze", "fetch_wall", "fetch_pick_place"])
def test_no_steps_is_a_legal_rollout(name, worlds):
    world = worlds[name]
    world.reset(seed=0)
    with RolloutEngine(world.dynamics, 2) as engine:
        actions = np.zeros((3, 0, world.action_space.shape[0]), np.float32)
        trajectories = engine.rollout(get_state(world.model, world.data), actions)
    assert trajectories.achieved_goals.shape[:2] == (3, 0) and not trajectories.diverged.any()


@pytest.mark.parametrize("open_loop", [True, False])
def test_divergence_is_detected_although_mujoco_resets_to_finite_values(open_loop, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log into the working directory
    dynamics = Explosive(open_loop)
    data = mujoco.MjData(dynamics.model)
    actions = np.zeros((3, 4, 1))
    actions[1, 0] = 1.0  # in the very first physics step, from time zero
    with RolloutEngine(dynamics, 2) as engine:
        trajectories = engine.rollout(get_state(dynamics.model, data), actions)
    assert trajectories.diverged.tolist() == [False, True, False]
    assert np.isfinite(trajectories.observations[:, -1]).all(), "a NaN test alone would have found nothing"
