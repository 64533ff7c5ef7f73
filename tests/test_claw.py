"""The claw has the dimensions and the dynamics of the D'Claw, and its valve can be turned."""

import json

import mujoco
import numpy as np
import pytest
from test_envs import can_render

from mpc.rollout import RolloutEngine
from napsp import envs
from napsp.envs.claw import ClawEnv, direction
from napsp.envs.dynamics import get_state
from planners.app.cli import run

FINGERS = ("f1", "f2", "f3")


@pytest.fixture
def world(worlds):
    worlds["claw"].reset(seed=0)
    return worlds["claw"]


def test_sizes(world):
    assert (world.model.nq, world.model.nv, world.model.nu) == (10, 10, 9)
    assert world.action_space.shape == (9,)
    shapes = {key: space.shape for key, space in world.observation_space.spaces.items()}
    assert shapes == {"observation": (11,), "achieved_goal": (2,), "desired_goal": (2,)}
    actuated = [world.model.joint(joint).name for joint in world.model.actuator_trnid[:, 0]]
    assert actuated == [f"{f}_{joint}" for f in FINGERS for joint in ("abduction", "flexion", "tip_flexion")]
    assert world.model.actuator_trnid[:, 0].tolist() == list(range(9)), "targets are in the order of qpos"


def test_home_pose(world):
    assert world.data.ncon == 0
    tips = np.array([world.data.site(f"{f}_tip").xpos for f in FINGERS])
    np.testing.assert_allclose(np.hypot(tips[:, 0], tips[:, 1]), 0.119, atol=1e-3)
    np.testing.assert_allclose(tips[:, 2], 0.140, atol=1e-3)
    np.testing.assert_allclose(np.degrees(np.arctan2(tips[:, 1], tips[:, 0])) % 360, [60, 300, 180], atol=1e-6)


def test_fingers_hang_straight_at_the_middle_of_the_actions(world):
    world.data.qpos[:] = 0.0
    mujoco.mj_forward(world.model, world.data)
    tips = np.array([world.data.site(f"{f}_tip").xpos for f in FINGERS])
    np.testing.assert_allclose(np.hypot(tips[:, 0], tips[:, 1]), 0.060, atol=1e-3)
    np.testing.assert_allclose(tips[:, 2], 0.106, atol=1e-3)
    for action, target in ((0.0, (0, 0, 0)), (2.0, (0.48, np.pi / 3, np.pi / 2))):
        control = world.dynamics.control(np.full(9, action, np.float32))
        assert control.dtype == np.float64
        np.testing.assert_allclose(control, target * 3)


@pytest.mark.parametrize(("joint", "moves"), [("abduction", (0, 1)), ("flexion", (-1, 0)), ("tip_flexion", (-1, 0))])
def test_signs_of_the_joints(joint, moves, world):
    """Abduction moves the tip counter-clockwise, flexion towards the valve's axis."""
    for finger in FINGERS:
        world.data.qpos[:] = 0.0
        mujoco.mj_kinematics(world.model, world.data)
        before = world.data.site(f"{finger}_tip").xpos.copy()
        world.data.joint(f"{finger}_{joint}").qpos[0] = 1e-4
        mujoco.mj_kinematics(world.model, world.data)
        moved = (world.data.site(f"{finger}_tip").xpos - before)[:2]
        outward = before[:2] / np.linalg.norm(before[:2])
        around = np.array([-outward[1], outward[0]])
        np.testing.assert_allclose(np.sign(np.round([moved @ outward, moved @ around], 7)), moves)


def test_masses_and_joint_inertias(world):
    inertia = np.zeros((10, 10))
    mujoco.mj_fullM(world.model, world.data, inertia)
    np.testing.assert_allclose(np.diag(inertia), [0.0029, 0.0016, 0.00107] * 3 + [0.0020], rtol=0.03)
    assert world.model.body_subtreemass[0] == pytest.approx(3 * (0.105 + 0.105 + 0.032) + 0.4764)


def test_a_free_valve_stops_within_centimetres(world):
    """Its spin decays with an e-fold of 20 ms: the valve stops when the fingers stop."""
    world.data.qvel[-1] = 3.0
    speeds = []
    for _ in range(20):
        mujoco.mj_step(world.model, world.data)
        speeds.append(world.data.qvel[-1])
    rate = np.polyfit(world.model.opt.timestep * np.arange(20), np.log(speeds), 1)[0]
    assert -1.0 / rate == pytest.approx(0.020, abs=0.002)


def test_joints_settle_within_a_control_step_or_two(world):
    target = np.array([0.3, -0.8, 0.6] * 3, np.float32)
    for _ in range(3):
        observation = world.step(target / np.array([0.48, np.pi / 3, np.pi / 2] * 3, np.float32))[0]["observation"]
    np.testing.assert_allclose(observation[:9], target, atol=0.08)  # what is left is sag under gravity


def test_success_has_no_seam(world):
    for angle in (0.0, 1.0, np.pi, -2.5):
        for error in (0.0999, -0.0999, 2 * np.pi + 0.05):
            assert world.reached(direction(np.array(angle + error)), direction(np.array(angle)))
        for error in (0.1001, -0.1001, np.pi):
            assert not world.reached(direction(np.array(angle + error)), direction(np.array(angle)))
    near, far = direction(np.array([np.pi - 0.04, np.pi - 0.06])), direction(np.array([-np.pi + 0.04, -np.pi + 0.06]))
    assert world.reached(near, far).tolist() == [True, False]


def test_goals_are_uniform_on_the_circle(world):
    goals = np.array([world.reset(seed=seed)[0]["desired_goal"] for seed in range(1000)])
    np.testing.assert_allclose(np.linalg.norm(goals, axis=1), 1.0)
    angles = np.arctan2(goals[:, 0], goals[:, 1])
    counts = np.histogram(angles, bins=8, range=(-np.pi, np.pi))[0]
    assert counts.min() > 85, counts  # 125 expected, 4 standard deviations


def test_the_valve_turns_without_end(world):
    """A goal after more than one turn is still the same goal."""
    world.data.qpos[-1] = 20.0
    observation = world.step(np.zeros(9, np.float32))[0]
    angle = world.data.qpos[-1]
    assert angle > 19.0 and not world.model.joint("valve").limited
    np.testing.assert_array_equal(observation["achieved_goal"], [np.sin(angle), np.cos(angle)])
    np.testing.assert_array_equal(observation["observation"][9:], observation["achieved_goal"])


def test_goal_positions_lie_before_the_marked_arm(world):
    for angle in (0.3, -2.0):
        world.data.qpos[-1] = angle
        mujoco.mj_kinematics(world.model, world.data)
        drawn = world.goal_positions(direction(np.full((4, 5), angle)))
        assert drawn.shape == (4, 5, 3)
        np.testing.assert_allclose(drawn[2, 3], world.data.site("valve_mark").xpos, atol=0.007)


def test_a_batch_is_observed_like_single_rows(world):
    features = np.random.default_rng(0).normal(scale=4.0, size=(67, 9, world.dynamics.n_features))
    observations, goals = world.dynamics.observe(features)
    for index in np.ndindex(67, 9):
        observation, goal = world.dynamics.observe(features[index])
        np.testing.assert_array_equal(observations[index], observation)
        np.testing.assert_array_equal(goals[index], goal)


def sweeping(rng, n_steps):
    """Actions ``(n_steps, 9)``: fingers reach in and sweep the valve's arms to and fro, with noise."""
    actions = rng.uniform(-0.3, 0.3, (n_steps, 9))
    actions[:, ::3] += np.sin(rng.uniform(0, 2 * np.pi) + 0.7 * np.arange(n_steps))[:, None]
    actions[:, 1::3] += 0.2
    return np.clip(actions, -1, 1).astype(np.float32)


def touches_valve(world):
    valve = world.model.body("valve").id
    return any(valve in world.model.geom_bodyid[contact.geom] for contact in world.data.contact[: world.data.ncon])


def test_rollout_equals_step_while_the_fingers_push_the_valve(world):
    with RolloutEngine(world.dynamics, n_threads=2) as engine:
        for seed in range(20):
            world.reset(seed=seed)
            actions = sweeping(np.random.default_rng(seed), 40)
            for action in actions[:15]:
                world.step(action)
            trajectories = engine.rollout(
                get_state(world.model, world.data), np.stack([-actions[15:], actions[15:], actions[:-15]])
            )
            assert not trajectories.diverged.any()
            touched = 0
            for step, action in enumerate(actions[15:]):
                following = world.step(action)[0]
                np.testing.assert_array_equal(trajectories.observations[1, step], following["observation"])
                np.testing.assert_array_equal(trajectories.achieved_goals[1, step], following["achieved_goal"])
                touched += touches_valve(world)
            assert touched >= 12, f"the fingers touch the valve in {touched} of 25 steps only"


def test_rendering():
    if not can_render():
        pytest.skip("no off-screen OpenGL on this machine: nothing can be drawn")
    drawn = ClawEnv(render_mode="rgb_array")
    drawn.reset(seed=0)
    frame = drawn.render()
    drawn.close()
    red, green, blue = frame.reshape(-1, 3).astype(int).T
    assert frame.shape == (480, 480, 3)
    assert ((red > 100) & (red > 2 * green) & (red > 2 * blue)).sum() > 500, "the marked arm is not in the picture"


def test_unknown_render_mode_is_refused():
    with pytest.raises(ValueError, match="render_mode 'ansi' is not one of"):
        ClawEnv(render_mode="ansi")


@pytest.mark.slow
def test_planning_with_the_chord_turns_the_valve(tmp_path):
    """The chord to the goal grows with the angle to it, so nothing has to be learned to plan."""
    arguments = ["--env", "claw", "--cost", "euclidean", "--samples", "24", "--episodes", "2", "--seed", "3"]
    assert run("mppi", [*arguments, "--no-video", "--out", str(tmp_path)]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["any_success_rate"] == 1.0
    assert summary["mean_steps_to_goal"] < envs.episode_length("claw") / 2
