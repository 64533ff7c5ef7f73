"""The tasks keep Gymnasium's rules, equal stock Fetch, and their walls are walls."""

import subprocess
import sys
import warnings
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from conftest import TASKS
from gymnasium.utils.env_checker import check_env

from napsp import envs
from napsp.envs.actions import used_actions
from napsp.envs.fetch import FetchReachEnv, FetchReachWallEnv
from napsp.errors import UserError


@pytest.mark.parametrize("name", TASKS)
def test_gymnasium_checker(name):
    with warnings.catch_warnings():
        # The checker advises against unbounded spaces; gymnasium-robotics' own are unbounded.
        warnings.filterwarnings("ignore", message=".*(infinity|-inf|render).*")
        check_env(envs.make(name).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("name", TASKS)
def test_goal_env_api(name, worlds):
    world = worlds[name]
    observation, _ = world.reset(seed=1)
    action = np.ones(world.action_space.shape, np.float32)
    following, reward, terminated, truncated, info = world.step(action)
    assert not terminated and not truncated
    assert set(observation) == {"observation", "achieved_goal", "desired_goal"}
    achieved = np.stack([following["achieved_goal"], following["desired_goal"]])
    goals = np.stack([following["desired_goal"]] * 2)
    rewards = world.compute_reward(achieved, goals, [{}, {}])
    assert rewards.shape == (2,) and rewards[1] == 0.0
    assert rewards[0] == reward and (reward == 0) == info["is_success"]


def test_time_limit_truncates():
    env = envs.make("fetch_wall")
    env.reset(seed=0)
    ends = [env.step(env.action_space.sample())[2:4] for _ in range(50)]
    assert ends == [(False, False)] * 49 + [(False, True)]
    env.close()


def test_names():
    assert envs.canonical_name("fetch_reach_wall") == envs.canonical_name("napsp/FetchReachWall-v0") == "fetch_wall"
    for alias in ("fetch_pick_and_place_wall", "pick_place_wall", "napsp/FetchPickPlaceWall-v0"):
        assert envs.canonical_name(alias) == "fetch_pick_place_wall"
    assert envs.canonical_name("fetch_pick_and_place") == "fetch_pick_place"
    with pytest.raises(UserError, match=r"unknown environment 'nope'; choose one of: point_maze"):
        envs.make("nope")


def test_same_seed_same_episode(worlds):
    for world in worlds.values():
        runs = []
        for _ in range(2):
            rng = np.random.default_rng(0)
            observation, _ = world.reset(seed=5)
            rows = [observation["observation"]]
            for _ in range(10):
                rows.append(world.step(rng.uniform(-1, 1, world.action_space.shape))[0]["observation"])
            runs.append(np.array(rows))
        np.testing.assert_array_equal(*runs)


def test_equals_stock_fetch_reach_bit_for_bit():
    """With stock collisions our step is gymnasium-robotics' step, to the last bit of the state."""
    import gymnasium_robotics

    gymnasium.register_envs(gymnasium_robotics)
    stock, ours = gymnasium.make("FetchReach-v4").unwrapped, FetchReachEnv(arm_self_collision=True)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        first, second = stock.reset(seed=seed)[0], ours.reset(seed=seed)[0]
        for _ in range(40):
            for key in first:
                np.testing.assert_allclose(first[key], second[key], rtol=0, atol=1e-15)
            np.testing.assert_array_equal(stock.data.qpos, ours.data.qpos)
            np.testing.assert_array_equal(stock.data.qvel, ours.data.qvel)
            action = rng.uniform(-1.5, 1.5, 4).astype(np.float32)
            first, second = stock.step(action)[0], ours.step(action)[0]


def can_render():
    """Whether mujoco can create an OpenGL context, without any code of this package."""
    code = "import mujoco; mujoco.GLContext(16, 16).make_current()"
    return subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


@pytest.mark.parametrize("name", ["fetch_wall", "fetch_pick_place"])
def test_rendering_does_not_change_the_dynamics(name, worlds):
    # Only a missing OpenGL excuses this test; an error of our own rendering fails it.
    if not can_render():
        pytest.skip("no off-screen OpenGL on this machine: nothing can be drawn")
    plain, drawn = worlds[name], envs.make(name, render_mode="rgb_array").unwrapped
    drawn.reset(seed=0)
    drawn.render()
    plain.reset(seed=3), drawn.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(15):
        action = rng.uniform(-1, 1, 4).astype(np.float32)
        plain.step(action), drawn.step(action)
        drawn.render()
        np.testing.assert_array_equal(plain.data.qpos, drawn.data.qpos)
    shown = drawn.data.site_xpos[drawn.model.site("target0").id]
    np.testing.assert_allclose(shown, drawn.goal_positions(drawn.goal), atol=1e-12)
    drawn.close()


@pytest.mark.parametrize("name", ["fetch_wall", "fetch_wall_high"])
def test_fetch_wall_is_solid_and_can_be_crossed_only_above(worlds, name):
    world = worlds[name]
    rng = np.random.default_rng(0)
    for episode in range(6):  # full push into the wall with random sideways drift
        world.reset(seed=episode)
        drift = rng.uniform(-1, 1, 2)
        for _ in range(60):
            push = np.array([drift[0], 1.0, min(drift[1], 0.0), 0.0], np.float32)
            grip = world.step(push)[0]["achieved_goal"]
        assert grip[1] < world.WALL_Y, "the gripper went through the wall or around it"
    observation, _ = world.reset(seed=0)
    clear, success = world.TABLE_TOP + world.wall_height + 0.06, False
    for _ in range(50):  # up, across, down
        grip, goal = observation["achieved_goal"], observation["desired_goal"]
        over = np.array([grip[0], goal[1], clear]) if grip[1] < 0.83 else goal
        target = grip + np.array([0, 0, 0.1]) if grip[1] < 0.7 and grip[2] < clear - 0.02 else over
        action = np.append(np.clip((target - grip) / 0.033, -1, 1), 0.0)
        observation, _, _, _, info = world.step(action)
        success |= info["is_success"]
    assert success, "the scripted path over the wall no longer reaches the goal"


def test_fetch_wall_start_and_goals(worlds):
    world = worlds["fetch_wall"]
    for seed in range(30):
        observation, _ = world.reset(seed=seed)
        assert observation["achieved_goal"][1] < world.WALL_Y - 0.1
        goal = observation["desired_goal"]
        assert goal[1] > world.WALL_Y + 0.09 and goal[2] <= 0.44


@pytest.mark.parametrize("name", ["point_maze", "point_maze_long"])
def test_maze_rooms_and_walls(name, worlds):
    world = worlds[name]
    for seed in range(10):
        observation, _ = world.reset(seed=seed)
        assert (observation["achieved_goal"] < 0).all() and (observation["desired_goal"] > 0).all()
        for _ in range(80 * int(world.scale)):  # straight at the goal: stuck at the middle of the house
            gap = observation["desired_goal"] - observation["achieved_goal"]
            observation, _, _, _, info = world.step(np.clip(gap * 10, -1, 1))
        assert not info["is_success"]
        assert (np.abs(observation["achieved_goal"]) < world.scale).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
def test_stable_baselines3_trains_with_her(name):
    from stable_baselines3 import SAC, HerReplayBuffer

    env, steps = envs.make(name), envs.episode_length(name) + 20
    model = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        buffer_size=1000,
        learning_starts=steps,
        batch_size=32,
        seed=0,
    )
    model.learn(steps + 60)
    assert model.num_timesteps == steps + 60
    env.close()


def test_a_wall_needs_the_filtered_robot():
    with pytest.raises(ValueError, match="does not go with a wall"):
        FetchReachWallEnv(arm_self_collision=True)


@pytest.mark.parametrize("name", TASKS)
def test_numbers_of_an_action_that_change_nothing_are_known(name, worlds):
    world = worlds[name]
    world.reset(seed=0)
    before = world.data.qpos.copy()
    used = used_actions(world)
    blocked = name.startswith(("fetch_reach", "fetch_wall"))  # the gripper's fingers, the last of four numbers
    np.testing.assert_array_equal(used, [True] * (len(used) - blocked) + [False] * blocked)
    np.testing.assert_array_equal(world.data.qpos, before)


def test_a_task_without_dynamics_is_said_to_use_all_numbers():
    assert used_actions(SimpleNamespace(action_space=SimpleNamespace(shape=(3,)))).tolist() == [True] * 3


def test_maze_episodes_may_begin_and_end_in_any_room(worlds):
    world, rooms = worlds["point_maze"], set()
    for seed in range(60):
        seen, _ = world.reset(seed=seed, options={"anywhere": True})
        places = np.array([seen["achieved_goal"], seen["desired_goal"]])
        assert ((np.abs(places) > 0.1) & (np.abs(places) < 0.9)).all()
        assert np.isfinite(world.shortest_steps(places[:1], places[1])).all()
        rooms.add(tuple(np.sign(places).ravel()))
    assert len(rooms) > 12, "pairs of rooms"
    seen, _ = world.reset(seed=0)
    assert (seen["achieved_goal"] < 0).all() and (seen["desired_goal"] > 0).all(), "the task's own again"
