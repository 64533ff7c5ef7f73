"""Planned and executed trajectories are the same numbers, to the last bit."""

import itertools
import multiprocessing
import os
import select
import signal
import time

import mujoco
import numpy as np
import pytest
from conftest import TASKS
from scripted import play

from mpc.rollout import RolloutEngine
from mpc.workers import CAN_FORK
from napsp.envs.dynamics import INTEGRATION_STATE, get_state

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
    data = engine._datas[0]
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


def compare(world, engine, actions):
    """Largest difference between planned and executed numbers; executes the actions."""
    state = get_state(world.model, world.data)
    trajectories = engine.rollout(state, np.stack([actions[::-1], actions, actions]))
    with RolloutEngine(world.dynamics, 1) as alone:
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
    with RolloutEngine(world.dynamics, n_threads=2) as engine:
        for seed in range(20):
            actions = start_episode(world, seed, contact)
            assert compare(world, engine, actions) == 0.0
            contacts += world.data.ncon
    assert not contact or contacts >= 10, "the contact-rich episodes touch nothing"


@pytest.mark.parametrize("lift", [True, False], ids=["carry", "push"])
@pytest.mark.parametrize("name", PICK_PLACE)
def test_rollout_equals_step_while_grasping(name, lift, worlds):
    world = worlds[name]
    fingers = {world.model.geom(f"robot0:{side}_gripper_finger_link").id for side in "lr"}
    box, touched = world.model.geom("object0").id, 0
    with RolloutEngine(world.dynamics, n_threads=2) as engine:
        for seed in range(10):
            actions = start_grasp(world, seed, lift)
            touched += any(box in pair and fingers & set(pair) for pair in world.data.contact.geom.tolist())
            assert compare(world, engine, actions) == 0.0
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
        for simulation in engine._simulations:
            breakage(simulation)
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


class Explosive:
    """One slide joint that blows up under a large force."""

    open_loop, substeps, n_features = True, 5, 2

    def __init__(self, open_loop):
        self.open_loop = open_loop
        self.model = mujoco.MjModel.from_xml_string("""
            <mujoco><option timestep="0.01" integrator="Euler"/><worldbody><body>
            <joint name="x" type="slide"/><geom size="0.1" mass="1e-4"/></body></worldbody>
            <actuator><motor joint="x" gear="1e9"/></actuator></mujoco>""")

    def bind(self, data):
        return Bound(self, data)

    def control(self, actions):
        return np.asarray(actions, np.float64)

    def observe(self, features):
        return features, features


class Bound:
    def __init__(self, dynamics, data):
        self.model, self.data, self.substeps = dynamics.model, data, dynamics.substeps

    def advance(self, controls, features):
        for control, row in zip(controls, features, strict=True):
            self.data.ctrl[:] = control
            mujoco.mj_step(self.model, self.data, self.substeps)
            row[:] = self.data.qpos[0], self.data.qvel[0]

    def restore(self, state):
        mujoco.mj_setState(self.model, self.data, state, INTEGRATION_STATE)


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


class Stubborn(Explosive):
    """Refuses to be controlled by worker 1, or dies there."""

    def __init__(self, dies):
        super().__init__(open_loop=False)
        self.dies, self.bound = dies, 0

    def bind(self, data):
        bound = Bound(self, data)
        advance = bound.advance
        bound.advance = self.fail if self.bound else lambda *rows: (time.sleep(0.1), advance(*rows))
        self.bound += 1
        return bound

    def fail(self, controls, features):
        if self.dies:
            os._exit(1)
        raise ValueError("worker 1 will not")


@pytest.mark.skipif(not CAN_FORK, reason="this system's rollouts use threads")
@pytest.mark.parametrize(("dies", "message"), [(False, "worker 1 will not"), (True, "has died")])
def test_a_failing_helper_process_is_reported_and_replaced(dies, message):
    dynamics = Stubborn(dies)
    state, actions = get_state(dynamics.model, mujoco.MjData(dynamics.model)), np.zeros((4, 2, 1))
    with RolloutEngine(dynamics, 2) as engine:
        with pytest.raises(RuntimeError, match=message):
            engine.rollout(state, actions)
        engine._simulations[1].advance = engine._simulations[0].advance  # mended
        engine._simulations[1].restore = engine._simulations[0].restore
        engine._datas[1] = engine._datas[0]
        assert not engine.rollout(state, actions).diverged.any(), "a fresh helper takes over"


@pytest.mark.skipif(not CAN_FORK, reason="this system's rollouts use threads")
def test_helper_processes_keep_nothing_of_the_caller_open():
    """A video encoder, for one, waits for the end of the pipe it reads from."""
    dynamics = Explosive(open_loop=False)
    state, actions = get_state(dynamics.model, mujoco.MjData(dynamics.model)), np.zeros((4, 2, 1))
    reader, writer = os.pipe()
    with RolloutEngine(dynamics, 2) as engine, RolloutEngine(dynamics, 2) as other:
        engine.rollout(state, actions)
        other.rollout(state, actions)
        os.close(writer)
        assert select.select([reader], [], [], 10.0)[0] and os.read(reader, 1) == b"", "somebody still holds the pipe"
    os.close(reader)


@pytest.mark.skipif(not CAN_FORK, reason="this system's rollouts use threads")
def test_rollouts_run_in_daemons_and_under_a_callers_signal_handler(monkeypatch):
    dynamics = Explosive(open_loop=False)
    state, actions = get_state(dynamics.model, mujoco.MjData(dynamics.model)), np.zeros((4, 2, 1))
    handler = signal.signal(signal.SIGTERM, lambda *_: None)
    for _ in range(5):  # closed at once: the helper may not have its own handlers yet
        with RolloutEngine(dynamics, 2) as engine:
            engine.rollout(state, actions[:2])
    signal.signal(signal.SIGTERM, handler)
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)
    with RolloutEngine(dynamics, 2) as engine:
        assert not engine.rollout(state, actions).diverged.any()


@pytest.mark.skipif(not CAN_FORK, reason="this system's rollouts use threads")
def test_helper_processes_see_a_changed_model_after_reset_and_end_on_close():
    dynamics = Explosive(open_loop=False)
    state, actions = get_state(dynamics.model, mujoco.MjData(dynamics.model)), np.full((4, 2, 1), 1e-9)
    engine = RolloutEngine(dynamics, 2)
    before = engine.rollout(state, actions).observations
    dynamics.model.actuator_gear[0, 0] *= 2.0
    engine.reset()
    after = engine.rollout(state, actions).observations
    assert (after[1] > before[1]).all()
    np.testing.assert_array_equal(after[0], after[1])
    (helper,) = engine._helpers._processes
    engine.close()
    assert not any(helper is child for child in multiprocessing.active_children())
