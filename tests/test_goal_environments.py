"""Any Gymnasium goal environment trains; what is missing is said in one sentence. The documented page is run."""

import json
import re
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from line import Line
from tiny import learned, tiny

from napsp import envs
from napsp.data.collect import roll
from napsp.data.episodes import ARRIVED, CUT
from napsp.envs.goal_task import GoalTask, is_goal_task, make_goal_task
from napsp.errors import UserError
from napsp.storage.checkpoint import load_model
from napsp.train import train

PAGE = (Path(__file__).parents[1] / "docs" / "goal_environments.md").read_text()


class Ones(Line):
    def compute_reward(self, achieved_goal, desired_goal, info):
        return super().compute_reward(achieved_goal, desired_goal, info) + 1.0


class Dense(Line):
    def compute_reward(self, achieved_goal, desired_goal, info):
        return -np.abs(achieved_goal - desired_goal)[..., 0]


class Single(Line):
    def compute_reward(self, achieved_goal, desired_goal, info):
        return -float(abs(achieved_goal[0] - desired_goal[0]) > 0.25)


class Lopsided(Ones):
    """Actions from -1 to 3, float64; refuses others."""

    def __init__(self):
        super().__init__()
        self.action_space = spaces.Box(-1.0, 3.0, (1,), np.float64)
        self.did = []

    def step(self, action):
        assert self.action_space.contains(action)
        self.did.append(float(action[0]))
        return super().step(action)


class Backwards(gymnasium.ActionWrapper):
    def action(self, action):
        return -action


def reversed_line():
    return Backwards(Ones())


class Ends(Ones):
    """Episodes end at the goal, and beyond an edge behind the start."""

    def __init__(self):
        super().__init__(goal=1.0, ends_at_goal=True)

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        self.over = terminated or bool(self.place < -1.5)
        return observation, reward, self.over, truncated, info


def with_spaces(**parts):
    """A class whose observation or action space is another one."""

    class Other(Line):
        def __init__(self):
            super().__init__()
            own = dict(self.observation_space.spaces)
            self.action_space = parts.pop("action", self.action_space)
            self.observation_space = spaces.Dict({k: v for k, v in {**own, **parts}.items() if v is not None})

    return Other


IMAGE, BOX = spaces.Box(0, 255, (8, 8, 3), np.uint8), spaces.Box(-1, 1, (1,))
Image, Nested = with_spaces(observation=IMAGE), with_spaces(observation=spaces.Dict(a=BOX))
Goalless, Uneven = with_spaces(desired_goal=None), with_spaces(desired_goal=spaces.Box(-1, 1, (2,)))
Discrete, Unbounded = with_spaces(action=spaces.Discrete(3)), with_spaces(action=spaces.Box(-np.inf, np.inf, (1,)))


def near(achieved_goal, desired_goal):
    return np.abs(achieved_goal - desired_goal)[:, 0] < 0.5


def one_for_all(achieved_goal, desired_goal):
    return True


def far_from(name):
    return make_goal_task(f"{__name__}:{name}")


@pytest.mark.parametrize("name", ["Line", "Ones"])
def test_success_is_where_the_reward_is_that_of_being_there(name):
    env = far_from(name)
    assert is_goal_task(env) and envs.episode_length(f"{__name__}:{name}") == 8
    reached = env.get_wrapper_attr("reached")
    achieved = np.array([[0.0], [2.8], [3.1], [3.3]])
    assert reached(achieved, np.array([3.0])).tolist() == [False, True, True, False]
    assert reached(achieved.reshape(2, 2, 1), np.array([3.0])).shape == (2, 2) and bool(reached(achieved[1], [3.0]))
    assert env.get_wrapper_attr("compute_reward")(achieved, np.full((4, 1), 3.0), {}).tolist() == [-1, 0, 0, -1]
    episodes = roll([env], lambda s, g: np.full((1, 1), 0.5), [0], 8)
    assert episodes.lengths == [8] and episodes.endings == [CUT]


def test_dense_rewards_need_a_success_test_by_radius_or_function():
    name = f"{__name__}:Dense"
    with pytest.raises(UserError, match=r"compute_reward of .*Dense is dense \(it gives .*--reached RADIUS"):
        make_goal_task(name)
    achieved, goal = np.array([[2.4], [2.6], [2.95]]), np.array([3.0])
    for reached, expected in (("0.1", [0, 0, 1]), (f"{__name__}:near", [0, 1, 1])):
        assert make_goal_task(name, reached).get_wrapper_attr("reached")(achieved, goal).tolist() == expected
    observation, reward, *_, info = (env := make_goal_task(name, "4")).reset() and env.step(np.zeros(1))
    assert reward == 0.0 and info["is_success"] and observation["achieved_goal"] == [0.0]
    wrong = {"-1": "positive radius", "wide": "positive radius", "nan": "positive radius"}
    for reached, words in {
        **wrong,
        f"{__name__}:one_for_all": "returned shape",
        f"{__name__}:no": "cannot load",
    }.items():
        with pytest.raises(UserError, match=words):
            make_goal_task(name, reached)


class Cells(Ones):
    """Whole numbers, and a success is to be at one exactly."""

    def reached(self, achieved_goal, desired_goal):
        return (np.asarray(achieved_goal) == desired_goal)[..., 0]


def test_whole_numbers_need_no_room_for_rounding(tmp_path):
    train(tiny(f"{__name__}:Cells", n_episodes=6), tmp_path)


class Never(Line):
    def compute_reward(self, achieved_goal, desired_goal, info):
        return np.full(np.shape(achieved_goal)[:-1], -1.0)


class Close(Ones):
    """Begins at its goal, where every sampled pair is a success."""

    def __init__(self):
        super().__init__(goal=0.0)

    def step(self, action):
        return super().step(np.zeros_like(action))


def test_a_reward_that_tells_nothing_apart_is_no_success_test():
    with pytest.raises(UserError, match="gives -1 wherever one is; name a success test"):
        make_goal_task(f"{__name__}:Never")
    make_goal_task(f"{__name__}:Close").close()


def test_the_whole_box_of_actions_is_used_and_scaled_once():
    env = far_from("Lopsided")
    assert env.action_space == spaces.Box(-1.0, 1.0, (1,), np.float32)
    env.reset(seed=0)
    for action in (-1.0, -0.5, 0.0, 1.0, 7.0):
        env.step(np.array([action], np.float32))
    assert env.unwrapped.did == [-1.0, 0.0, 1.0, 3.0, 3.0]


def test_a_model_remembers_the_box_it_acted_in(tmp_path, monkeypatch):
    name = f"{__name__}:Lopsided"
    train(tiny(name, n_episodes=6), tmp_path)
    model = load_model(tmp_path, name)
    assert model.header["action_box"] == [[-1.0], [3.0]]
    model.check_sizes(make_goal_task(name))
    monkeypatch.setattr(f"{__name__}.Lopsided", Ones)  # from -1 to 1
    with pytest.raises(UserError, match=r"trained with actions from \[-1\.0\] to \[3\.0\], and .* takes .* now"):
        model.check_sizes(make_goal_task(name))


def test_wrappers_stay():
    env = far_from("reversed_line")
    env.reset(seed=0)
    assert env.step(np.array([0.5], np.float32))[0]["achieved_goal"] == [-0.5]
    gymnasium.register("tests/Reversed-v0", f"{__name__}:reversed_line", max_episode_steps=5)
    try:
        env = make_goal_task("tests/Reversed-v0")
        episodes = roll([env], lambda s, g: np.full((1, 1), 0.5), [0], 9)
    finally:
        gymnasium.registry.pop("tests/Reversed-v0")
    assert episodes.achieved_goals[0, -1] == [-2.5] and episodes.lengths == [5] and episodes.endings == [CUT]


def test_what_can_be_planned_in_is_trained_as_it_is_planned():
    for name in ("point_maze", "FetchReach-v4", "napsp.envs.point_maze:PointMazeEnv"):
        env = make_goal_task(name)
        assert not is_goal_task(env) and type(env.unwrapped) is type(envs.make(name).unwrapped)
        with pytest.raises(UserError, match="has a success test of its own; leave out --reached"):
            make_goal_task(name, "0.1")
    wrapped = GoalTask(Backwards(Line()), near)
    assert is_goal_task(wrapped) and not is_goal_task(Line())


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Image", r"observes observation as an image of shape \(8, 8, 3\); give a flat Box"),
        ("Nested", "observes observation as a Dict; flatten it"),
        ("Goalless", "does not observe desired_goal; a goal environment observes a Dict of flat Boxes"),
        ("Uneven", "achieved and desired goals .* have different sizes"),
        ("Discrete", r"actions .* are Discrete\(3\); d and policy need continuous ones"),
        ("Unbounded", "give a flat Box with finite bounds"),
        ("Single", "failed for .* pairs of goals at once|answers otherwise|returned shape"),
    ],
)
def test_what_is_missing_is_named(name, words):
    with pytest.raises(UserError, match=words):
        far_from(name)
    with pytest.raises(UserError, match="CartPole-v1 observes a Box; a goal environment observes a Dict"):
        make_goal_task("CartPole-v1")


def test_planning_says_what_it_lacks():
    with pytest.raises(UserError, match=r"can not be planned in: it lacks dynamics, model, .* \(training needs none"):
        envs.make(f"{__name__}:Line")


@pytest.mark.parametrize("method", ["ours", "sparse", "plus"])
def test_episodes_that_end_train_and_resume_to_the_same_result(tmp_path, method):
    changes = {"method": method, "graph.every": 2, "graph.occupancy": 2, "graph.control": 0.1}
    name = f"{__name__}:Ends"
    whole = train(tiny(name, **changes), tmp_path / "whole")
    train(tiny(name, **changes, n_episodes=8), tmp_path / "parts")
    explorers = method == "plus"  # they begin with a reset after a pause: this task offers no state to go on from
    resumed = train(tiny(name, **changes), tmp_path / "parts")
    assert learned(resumed)[-1]["episodes"] == 16 and (explorers or learned(resumed) == learned(whole))
    model = load_model(tmp_path / "whole", name)
    assert model.config.reached is None and (model.distance is None) == (method == "sparse")


def test_some_of_them_end_at_the_goal():
    episodes = roll([far_from("Ends")], lambda s, g: np.full((1, 1), 0.3), [0], 8)
    assert episodes.lengths == [3] and episodes.endings == [ARRIVED]


def page(folder):
    """The page's task as a module, and its commands."""
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    (folder / "point.py").write_text(code)
    (commands,) = re.findall(r"```bash\n(.*?)```", PAGE, re.S)
    return [line.split("#")[0].split()[1:] for line in commands.splitlines()]


def command(folder, *arguments):
    done = subprocess.run([sys.executable, *arguments], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_documented_commands_do_what_the_page_says(tmp_path):
    training, evaluation, planning = page(tmp_path)
    assert "next: python -m planners.mppi --env point:Point" in command(tmp_path, *training)
    assert "policy on point:Point" in command(tmp_path, *evaluation, "--out", "found.json")
    assert json.loads((tmp_path / "found.json").read_text())["success_rate"] >= 0.9
    said = command(tmp_path, *planning, "--out", "plans", "--episodes", "2", "--hold", "3")
    assert "16 steps of 2 episodes came as planned, to the bit" in said
    assert json.loads((tmp_path / "plans" / "summary.json").read_text())["success_rate"] == 1.0
