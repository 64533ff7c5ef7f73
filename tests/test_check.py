"""A task of the user's own that breaks its contract is named in one sentence; one that keeps it is left alone."""

import sys
import warnings

import numpy as np
import pytest
from commands import in_this_process
from gymnasium import spaces

from napsp import envs
from napsp.data.collect import roll
from napsp.data.episodes import BLOWN, CUT
from napsp.envs.attempts import check_finite
from napsp.envs.check import check_task
from napsp.envs.open_loop import OpenLoopEnv
from napsp.envs.point_maze import PointMazeEnv
from napsp.errors import UserError


class Broken(PointMazeEnv):
    """A maze in which one member is replaced."""

    def __init__(self, **members):
        super().__init__()
        for name, member in members.items():
            setattr(self, name, member)


class Changed:
    """The maze's dynamics with other members."""

    def __init__(self, **members):
        self._own = PointMazeEnv().dynamics
        self.__dict__ |= members

    def __getattr__(self, name):
        return getattr(self._own, name)


STRICT = """
import numpy as np
from napsp.envs.point_maze import PointMazeEnv

class Strict(PointMazeEnv):
    max_episode_steps = np.int64(20)
    n_resets = 0

    def reset(self, **options):
        self.n_resets += 1
        return super().reset(**options)

    def reached(self, achieved_goal, desired_goal):
        assert np.shape(achieved_goal) == np.shape(desired_goal)
        return super().reached(achieved_goal, desired_goal)
"""


def in_batches(observe):
    """The maze's ``observe`` for one row, another for batches."""
    return lambda features: PointMazeEnv().dynamics.observe(features) if features.ndim == 1 else observe(features)


def raising(*arguments, **options):
    raise RuntimeError("out of order")


def test_tasks_that_keep_the_contract_pass_without_a_word():
    for name in ("point_maze", "fetch_wall", "claw", "FetchPush-v4"):
        env = envs.make(name)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            check_task(env.unwrapped, name)
        env.close()


@pytest.mark.parametrize(
    ("members", "words"),
    [
        ({"action_space": spaces.Discrete(4)}, "actions of task must be a flat Box from -1 to 1"),
        ({"action_space": spaces.Box(-2, 2, (2,))}, "actions of task must be a flat Box from -1 to 1"),
        ({"observation_space": spaces.Box(-1, 1, (4,))}, "must observe a Dict of three flat Box spaces"),
        (
            {"reset": lambda: None},
            r"reset of task can not be called as Gymnasium does .*take seed=None and options=None",
        ),
        ({"reset": lambda seed=None: ({}, {})}, "got an unexpected keyword argument 'options'"),
        ({"reset": raising}, r"reset\(seed=0, options=None\) of task failed with RuntimeError: out of order"),
        ({"reset": lambda seed, options: {"observation": 3.0}}, "must return a tuple of observation and info"),
        ({"reset": lambda seed, options: ({"observation": 3.0}, {})}, "observes observation as float; give an array"),
        ({"step": lambda action: ({}, 0.0, False, {})}, "observation, reward, terminated, truncated and info"),
        ({"reached": lambda achieved, goal: True}, r"reached of task returns bool of shape \(\); .*of shape \(3, 2\)"),
        ({"compute_reward": raising}, r"compute_reward of task failed with RuntimeError: out of order \(test_check.py"),
        ({"goal_positions": lambda goals: goals}, r"goal_positions of task returns float64 of shape \(3, 2, 2\)"),
        ({"goal_positions": lambda goals: np.full((3, 2, 3), np.nan)}, "goal_positions of task returns numbers that"),
        ({"compute_reward": lambda achieved, goal, info: np.full(2, -0.5)}, "must be 0 where reached and -1 elsewhere"),
        ({"step_length": None}, "step_length of task is None; give a positive number"),
        ({"dynamics": Changed(control=lambda actions: actions[:, 0])}, r"returns float32 of shape \(3, 2\); it must"),
        (
            {"dynamics": Changed(control=lambda a: a * np.sum(a))},
            "control of task depends on what else is in the batch",
        ),
        (
            {"dynamics": Changed(observe=in_batches(lambda f: (f[..., :1], f[..., :2])))},
            r"observe \(observation\) of task returns",
        ),
        (
            {"dynamics": Changed(observe=in_batches(lambda f: f))},
            "must return a tuple of observation and achieved goal",
        ),
        (
            {"dynamics": Changed(observe=in_batches(lambda f: (0 * f + f[0, 0], f[..., :2])))},
            "observe of task depends on what else is in the batch",
        ),
        (
            {"dynamics": Changed(control=lambda actions: np.zeros((*actions.shape[:-1], 5)))},
            "returns 5 numbers per action and the model has 2",
        ),
        ({"camera": "nowhere"}, "camera of task failed with KeyError"),
        ({"step": raising}, "step of task failed with RuntimeError"),
    ],
)
def test_a_broken_member_is_named(members, words):
    with pytest.raises(UserError, match=words):
        check_task(Broken(**members), "task")


def test_a_step_that_planning_does_not_foresee_is_warned_of():
    class Windy(PointMazeEnv):
        def step(self, action):
            return super().step(np.asarray(action) + 0.1)

    class Weak(PointMazeEnv):
        def step(self, action):
            return super().step(0.5 * np.asarray(action))

    for kind in (Windy, Weak):
        with pytest.warns(RuntimeWarning, match="task: a planned step differs from step"):
            check_task(kind(), "task")


def test_observations_that_the_next_step_overwrites_are_warned_of():
    class Views(PointMazeEnv):
        def _observation(self):
            observation, achieved_goal = self._features[0], self._features[0, :2]
            return {"observation": observation, "achieved_goal": achieved_goal, "desired_goal": self.goal.copy()}

    with pytest.warns(RuntimeWarning, match="task: a step overwrites the observation of the one before"):
        check_task(Views(), "task")


def test_a_success_test_need_not_broadcast_and_the_task_handed_out_is_untouched(tmp_path, monkeypatch):
    (tmp_path / "strict_task.py").write_text(STRICT)
    monkeypatch.syspath_prepend(str(tmp_path))
    env = envs.make("strict_task:Strict")
    assert env.unwrapped.n_resets == 0 and envs.episode_length("strict_task:Strict") == 20
    env.close()


def test_numbers_that_are_not_finite_end_an_episode_and_stop_planning():
    class Lost(PointMazeEnv):
        """The observation fails in the third step."""

        def reset(self, **options):
            self.n_steps = 0
            return super().reset(**options)

        def step(self, action):
            self.n_steps += 1
            observation, *others = OpenLoopEnv.step(self, action)
            if self.n_steps == 3:
                observation["achieved_goal"] = np.array([np.nan, 0.0])
            return observation, *others

    with pytest.warns(RuntimeWarning, match="the simulation of Lost blew up; the episode ends before"):
        episodes = roll([Lost()], lambda observations, goals: np.zeros((1, 2)), [0], 5)
    assert episodes.lengths == [2] and episodes.endings == [BLOWN] and np.isfinite(episodes.achieved_goals).all()
    assert roll([Lost()], lambda observations, goals: np.zeros((1, 2)), [0], 2).endings == [CUT]
    with pytest.raises(UserError, match="desired_goal"):
        check_finite(
            {"observation": np.zeros(2), "achieved_goal": np.zeros(1), "desired_goal": np.array([np.inf])}, "x"
        )


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("class Task: pass", "my_task:Task is no gymnasium.Env"),
        ("from napsp.envs.point_maze import PointMazeEnv\nclass Task(PointMazeEnv):\n    max_episode_steps = 0",
         "max_episode_steps of my_task:Task is 0"),
        ("from napsp.envs.point_maze import PointMazeEnv\nclass Task(PointMazeEnv):\n    def _start(self):\n"
         "        super()._start()\n        self.goal = self.goal * float('nan')", "not finite in desired_goal"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("command", ["napsp.train", "planners.mppi --cost euclidean --no-video"])
def test_commands_refuse_broken_classes_without_a_traceback(tmp_path, body, words, command, capsys, monkeypatch):
    (tmp_path / "my_task.py").write_text(body)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_task", raising=False)
    asked = (*command.split(), "--env", "my_task:Task")
    status, said = in_this_process(*asked, capsys=capsys, monkeypatch=monkeypatch)
    assert status == 2 and words in said and len(said.strip().splitlines()) == 1
