"""Environments that nobody prepared for: stock robots by id, a user's class by module:Class."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mpc.rollout import RolloutEngine
from napsp import envs
from napsp.config import preset
from napsp.envs.dynamics import get_state
from napsp.errors import UserError
from planners.app.cli import run as planned

STOCK = [
    "FetchPush-v4",
    "FetchPickAndPlace-v4",
    "HandReach-v3",
    "HandManipulateBlock-v1",
    "PointMaze_UMaze-v3",
    "AntMaze_UMaze-v5",
]
USER_MODULE = """
from napsp.envs.point_maze import PointMazeEnv

class BigMaze(PointMazeEnv):
    max_episode_steps = 12

    def __init__(self, **kwargs):
        super().__init__(scale=2.0, **kwargs)


def far(achieved_goals, goal):
    return abs(achieved_goals - goal).sum(-1)
"""


@pytest.mark.parametrize("name", STOCK)
def test_stock_robots_plan_exactly(name):
    env = envs.make(name)
    world = env.unwrapped
    with RolloutEngine(world.dynamics, 2) as engine:
        for seed in range(2):
            rng = np.random.default_rng(seed)
            env.reset(seed=seed)
            actions = rng.uniform(-1.2, 1.2, (4, 12, *world.action_space.shape)).astype(np.float32)
            for action in actions[0, :4]:
                env.step(action)
            planned = engine.rollout(get_state(world.model, world.data), actions)
            assert not planned.diverged.any()
            for t in range(12):
                observation, reward, terminated, _, info = env.step(actions[3, t])
                np.testing.assert_array_equal(observation["observation"], planned.observations[3, t])
                np.testing.assert_array_equal(observation["achieved_goal"], planned.achieved_goals[3, t])
                assert reward == (0.0 if info["is_success"] else -1.0) and not terminated
    env.close()


def test_adapted_robots_follow_stock_up_to_the_age_of_their_poses():
    import gymnasium

    ours, stock = envs.make("FetchPush-v4"), gymnasium.make("FetchPush-v4")
    first, _ = ours.reset(seed=3)
    second, _ = stock.reset(seed=3)
    np.testing.assert_array_equal(first["desired_goal"], second["desired_goal"])
    for action in np.random.default_rng(0).uniform(-1, 1, (10, 4)).astype(np.float32):
        first, second = ours.step(action)[0], stock.step(action)[0]
    np.testing.assert_allclose(first["achieved_goal"], second["achieved_goal"], atol=2e-3)
    np.testing.assert_allclose(first["observation"][:3], second["observation"][:3], atol=5e-3)
    ours.close()
    stock.close()


@pytest.mark.parametrize(("name", "left_out"), [("PointMaze_UMaze-v3", 0), ("AntMaze_UMaze-v5", 2)])
def test_adapted_mazes_equal_stock_ones_and_observe_the_position(name, left_out):
    import gymnasium

    ours, stock = envs.make(name), gymnasium.make(name)
    first, second = ours.reset(seed=3)[0], stock.reset(seed=3)[0]
    rng = np.random.default_rng(0)
    for _ in range(20):
        np.testing.assert_array_equal(first["desired_goal"], second["desired_goal"])
        np.testing.assert_array_equal(first["achieved_goal"], second["achieved_goal"])
        np.testing.assert_array_equal(first["observation"][left_out:], second["observation"])
        np.testing.assert_array_equal(first["observation"][:2], first["achieved_goal"])
        action = rng.uniform(-1, 1, ours.action_space.shape).astype(np.float32)
        (first, reward, *_), (second, stock_reward, *_) = ours.step(action), stock.step(action)
        assert reward == stock_reward - 1
    assert ours.observation_space.contains(first)
    ours.close()
    stock.close()


def test_mazes_are_reached_where_stock_says_so_and_seen_as_a_whole():
    world = envs.make("PointMaze_UMaze-v3").unwrapped
    world.reset(seed=0)
    goals = world.goal + np.array([[0.0, 0.44], [0.3, 0.3], [0.0, 0.46], [0.4, 0.4]])
    assert world.reached(goals, world.goal).tolist() == [True, True, False, False]
    assert world.compute_reward(goals, np.tile(world.goal, (4, 1)), {}).tolist() == [0, 0, -1, -1]
    angle = np.deg2rad(world.model.vis.global_.fovy / 2)  # the whole extent fits in the height of a picture
    assert world.camera.distance * np.tan(angle) > 0.45 * world.model.stat.extent
    np.testing.assert_array_equal(world.camera.lookat, world.model.stat.center)
    world.goal = np.array([0.5, -0.5])
    np.testing.assert_array_equal(world.model.site("target").pos[:2], [0.5, -0.5])
    world.close()


def test_adapted_robots_serve_vectorised_rewards_and_pictures():
    world = envs.make("FetchPush-v4").unwrapped
    goals = np.random.default_rng(0).uniform(0, 1, (6, 5, 3))
    rewards = world.compute_reward(goals, goals + np.array([0.0, 0.0, 0.04]), {})
    assert rewards.shape == (6, 5) and not rewards.any()
    assert (world.compute_reward(goals, goals + 0.1, {}) == -1).all()
    assert world.goal_positions(np.zeros((2, 15))).shape == (2, 3) == world.goal_positions(np.zeros((2, 2))).shape
    world.close()


@pytest.mark.parametrize(
    "name", ["FetchPush-v4", "HandReach-v3", "HandManipulateBlock-v1", "HandManipulatePen-v1", "PointMaze_UMaze-v3"]
)
def test_success_is_judged_in_any_batch_as_stock_judges_a_pair(name):
    env = envs.make(name)
    world = env.unwrapped
    rng = np.random.default_rng(0)
    observation, _ = env.reset(seed=0)
    goal = observation["desired_goal"]
    near = goal + rng.uniform(-0.5, 0.5, (6, 5, goal.size)) * np.linspace(0.0, 1.0, 6)[:, None, None]
    batch = world.reached(near, goal)
    assert batch.shape == (6, 5) and batch[0].all() and not batch.all()
    single = [[bool(world.reached(row, goal)) for row in rows] for rows in near]
    np.testing.assert_array_equal(batch, single)
    stock = world._stock.env
    if hasattr(stock, "_is_success"):
        np.testing.assert_array_equal(batch, [[bool(stock._is_success(row, goal)) for row in rows] for rows in near])
    env.close()


WIDE = """
import numpy as np
from gymnasium import spaces
from gymnasium_robotics.envs.fetch.reach import MujocoFetchReachEnv

class Centimetres(MujocoFetchReachEnv):
    max_episode_steps = 5
    low, high = [0, 0, 0, -5], [5, 2, 5, 5]

    def __init__(self, **options):
        super().__init__(**options)
        self.action_space = spaces.Box(np.float32(self.low), np.float32(self.high))
        self.received = []

    def _set_action(self, action):
        self.received.append(np.array(action))
        super()._set_action(np.clip(np.asarray(action, np.float64) / 5, -1, 1))

class Unbounded(Centimetres):
    high = [5, np.inf, 5, 5]
"""


def test_the_whole_box_of_stock_actions_is_planned_in(tmp_path, monkeypatch):
    (tmp_path / "wide_box.py").write_text(WIDE)
    monkeypatch.syspath_prepend(str(tmp_path))
    env = envs.make("wide_box:Centimetres")
    world = env.unwrapped
    assert env.action_space.low.tolist() == [-1] * 4 and env.action_space.high.tolist() == [1] * 4
    env.reset(seed=0)
    ends = np.array([[-1, -1, -1, -1], [1, 1, 1, 1], [0, 0, 0, 0], [-3, 0.5, 3, 0]], np.float32)
    state = get_state(world.model, world.data)
    with RolloutEngine(world.dynamics, 2) as engine:
        planned = engine.rollout(state, np.stack([ends, ends]))
    executed = np.array([env.step(action)[0]["observation"] for action in ends])
    np.testing.assert_array_equal(planned.observations, np.stack([executed, executed]))
    received = np.array(world._stock.env.received[-4:])
    np.testing.assert_array_equal(received, [[0, 0, 0, -5], [5, 2, 5, 5], [2.5, 1, 2.5, 0], [0, 1.5, 5, 0]])
    env.close()
    with pytest.raises(UserError, match="the actions of Unbounded have no bounds"):
        envs.make("wide_box:Unbounded")


def test_episode_lengths_and_configurations_of_foreign_tasks():
    assert envs.episode_length("HandReach-v3") == 50
    assert preset("FetchPush-v4").env == "FetchPush-v4" and preset("FetchPush-v4").episode_length == 50
    assert envs.file_name("FetchPush-v4") == "FetchPush-v4"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nowhere:Env", "cannot load nowhere:Env"),
        ("napsp.envs.point_maze:Missing", "cannot load"),
        ("CartPole-v1", "can not be planned in: it lacks dynamics"),
        ("FetchFly-v9", "unknown environment 'FetchFly-v9'"),
    ],
)
def test_what_can_not_be_planned_in_is_named(name, words):
    with pytest.raises(UserError, match=words):
        envs.make(name)


def test_the_documented_example_plans_exactly_and_its_post_is_in_the_way(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "docs"))
    env = envs.make("two_link_arm:TwoLinkArm")
    world = env.unwrapped
    sweep = np.zeros((1, 40, 2), np.float32)
    sweep[..., 0] = 1.0
    with RolloutEngine(world.dynamics, 2) as engine:
        for seed in range(5):
            world.reset(seed=seed)
            planned = engine.rollout(get_state(world.model, world.data), sweep)
            executed = np.array([world.step(action)[0]["achieved_goal"] for action in sweep[0]])
            np.testing.assert_array_equal(executed, planned.achieved_goals[0])
            assert world.data.qpos[1] < -0.5, "the post has folded the arm"
    env.close()


def test_an_id_of_a_package_is_spelled_as_gymnasium_spells_it(tmp_path, monkeypatch):
    entry = "entry_point='napsp.envs.point_maze:PointMazeEnv', kwargs={'scale': 3.0}"
    lines = ["import gymnasium", f"gymnasium.register('user/Big-v0', {entry}, max_episode_steps=7)"]
    (tmp_path / "their_package.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(UserError, match=r"unknown environment 'user/Big-v0'; .* package:Id"):
        envs.make("user/Big-v0")
    name = "their_package:user/Big-v0"
    assert envs.canonical_name(name) == name and envs.file_name(name) == "their_package-user-Big-v0"
    assert preset(name).episode_length == envs.episode_length(name) == 7
    assert envs.make(name).unwrapped.scale == envs.make("user/Big-v0").unwrapped.scale == 3.0
    assert envs.canonical_name("napsp.envs:napsp/PointMaze-v0") == "point_maze"
    with pytest.raises(UserError, match="cannot load their_package:user/Small-v0"):
        envs.canonical_name("their_package:user/Small-v0")


@pytest.mark.slow
def test_a_class_of_the_users_own_trains_and_plans(tmp_path, monkeypatch, capsys):
    (tmp_path / "my_maze.py").write_text(USER_MODULE)
    task = ["--env", "my_maze:BigMaze"]
    options = "--n-episodes 12 --n-warmup-episodes 4 --evaluate.n-episodes 2 --evaluate.every 6 --hidden 16 16"
    command = [sys.executable, "-m", "napsp.train", *task, *options.split()]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    checkpoint = tmp_path / "runs" / "my_maze-BigMaze-ours-s0"
    assert (checkpoint / "model.safetensors").is_file()
    plan = ["--episodes", "1", "--samples", "8", "--no-video", "--horizon", "4"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert (
        planned("mppi", [*task, *plan, "--checkpoint", str(checkpoint)]) == 0 and "distance" in capsys.readouterr().out
    )
    assert planned("icem", [*task, *plan, "--cost", "euclidean"]) == 0 and "euclidean" in capsys.readouterr().out
    assert list(tmp_path.glob("plans/my_maze-BigMaze-icem-euclidean-s90000-*/summary.json"))
    assert planned("cem", [*task, *plan, "--samples", "12", "--cost", "my_maze:far"]) == 0
    assert list(tmp_path.glob("plans/my_maze-BigMaze-cem-my_maze-far-s90000-*/summary.json"))
