"""A simulation that leaves physics ends the episode; planned episodes end where their task ends them."""

import gymnasium
import mujoco
import numpy as np
import pytest
from explosive import Explosive

from napsp.envs.blowups import BlowUpDetector
from napsp.envs.point_maze import PointMazeEnv
from napsp.errors import UserError
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session

SOUND = {"observation": np.zeros(1), "achieved_goal": np.zeros(1), "desired_goal": np.zeros(1)}


class Slider(gymnasium.Env):
    """A joint that a large force blows up; what it observes is finite all the same, for MuJoCo resets it."""

    def __init__(self):
        self.dynamics = Explosive(True)
        self.data = mujoco.MjData(self.dynamics.model)

    def push(self, force):
        self.data.ctrl[:] = force
        mujoco.mj_step(self.dynamics.model, self.data, 5)
        assert np.isfinite(self.data.qpos).all()


@pytest.mark.parametrize("n_quiet", [0, 3])
def test_a_silent_reset_by_mujoco_is_noticed_and_one_by_the_task_at_its_end_is_none(n_quiet):
    env = Slider()
    detector = BlowUpDetector(env)
    detector.begin()
    for _ in range(n_quiet):
        env.push(1e-9)
        assert not detector.blew_up(SOUND, False)
    env.push(1e9)
    assert detector.blew_up(SOUND, False)
    mujoco.mj_resetData(env.dynamics.model, env.data)
    detector.begin()
    env.push(1e-9)
    assert not detector.blew_up(SOUND, False)
    mujoco.mj_resetData(env.dynamics.model, env.data)
    assert not detector.blew_up(SOUND, True)
    assert detector.blew_up({**SOUND, "achieved_goal": np.array([np.inf])}, False)


class Ends(PointMazeEnv):
    """Is over after its third step."""

    max_episode_steps, n_steps = 6, 0

    def reset(self, **options):
        self.n_steps = 0
        return super().reset(**options)

    def step(self, action):
        observation, reward, _, _, info = super().step(action)
        self.n_steps += 1
        assert self.n_steps <= 3
        return observation, reward, self.n_steps == 3, False, info


class Blows(Ends):
    """Observes NaN in the step ``lost_at``."""

    def step(self, action):
        observation, *others = super().step(action)
        if self.n_steps == self.lost_at:
            observation["achieved_goal"] = observation["achieved_goal"] * np.nan
        return observation, *others

    lost_at = 99  # not while it is tried


def session(name):
    config = PlanConfig.of(
        "mppi", {"env": f"{__name__}:{name}", "cost": "euclidean", "search.samples": 4, "horizon": 2}
    )
    return Session.open(config, RunOptions(threads=1))


def test_a_planned_episode_ends_where_the_task_ends_it():
    planning = session("Ends")
    result = planning.run_episode(0)
    assert len(result.steps) == len(result.actions) == 3 and result.achieved_goals.shape == (4, 2)
    planning.close()


def test_a_planned_episode_that_blows_up_is_a_failure_and_said(monkeypatch):
    planning = session("Blows")
    monkeypatch.setattr(Blows, "lost_at", 3)
    with pytest.warns(RuntimeWarning, match=r"Blows blew up after 2 steps; the episode ends there, as a failure"):
        result = planning.run_episode(0)
    assert len(result.steps) == 2 and not result.success and np.isfinite(result.achieved_goals).all()
    monkeypatch.setattr(Blows, "lost_at", 1)
    with pytest.raises(UserError, match="blows up in its first step"):
        planning.run_episode(0)
    planning.close()
