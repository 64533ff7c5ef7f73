"""--goal in tasks of the user's own, and observations that a step overwrites."""

import numpy as np
import pytest

from napsp.envs.point_maze import PointMazeEnv
from napsp.errors import UserError
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session


class Views(PointMazeEnv):
    """Hands out what its next step overwrites."""

    max_episode_steps = 6

    def _observation(self):
        observation, achieved_goal = self._features[0], self._features[0, :2]
        return {"observation": observation, "achieved_goal": achieved_goal, "desired_goal": self.goal}


class Stubborn(PointMazeEnv):
    """Keeps its goal under another name."""

    max_episode_steps = 6

    def _observation(self):
        return {**super()._observation(), "desired_goal": np.array([0.5, 0.5])}


class Nameless(Stubborn):
    """Has no attribute of that name at all."""

    @property
    def goal(self):
        raise AttributeError("goal")

    @goal.setter
    def goal(self, goal):
        self.target = goal

    def reset(self, **options):
        PointMazeEnv.reset(self, **options)
        return self._observation(), {}

    def step(self, action):
        self._simulation.advance(self.dynamics.control(action)[None], self._features)
        return self._observation(), 0.0, False, False, {}

    def _observation(self):
        observation, achieved_goal = self.dynamics.observe(self._features[0].copy())
        return {"observation": observation, "achieved_goal": achieved_goal, "desired_goal": np.array([0.5, 0.5])}


def session(name, **settings):
    config = {"env": f"test_goals_of_users:{name}", "cost": "euclidean", "search.samples": 6, "horizon": 3}
    return Session.open(PlanConfig.of("mppi", config | settings), RunOptions(threads=1))


@pytest.mark.filterwarnings("ignore:.*a step overwrites the observation of the one before")
def test_an_episode_remembers_the_way_where_observations_are_overwritten():
    opened = session("Views")
    result = opened.run_episode(3)
    opened.close()
    assert len(np.unique(result.achieved_goals, axis=0)) == 7
    assert np.linalg.norm(result.achieved_goals[-1] - result.achieved_goals[0]) > 0.1


def test_a_goal_that_a_task_does_not_keep_to_is_named():
    opened = session("Stubborn", goal=(-0.5, -0.5))
    with pytest.raises(UserError, match="Stubborn does not keep to --goal; let step observe the attribute goal"):
        opened.run_episode(3)
    opened.close()
    with pytest.raises(UserError, match="--goal sets the attribute goal, which Nameless lacks"):
        session("Nameless", goal=(-0.5, -0.5))
