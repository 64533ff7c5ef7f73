"""A point on a line, without MuJoCo: its action is how far it moves. Episodes may end themselves."""

import gymnasium
import numpy as np
from gymnasium import spaces

REACH = 0.25


class Line(gymnasium.Env):
    """Refuses to be stepped after its end."""

    max_episode_steps = 8

    def __init__(self, start=0.0, goal=3.0, *, ends_at_goal=False, edge=np.inf, limit=10**9, nan_beyond=np.inf):
        self.start, self.goal = start, goal
        self.ends_at_goal, self.edge, self.limit, self.nan_beyond = ends_at_goal, edge, limit, nan_beyond
        one = spaces.Box(-np.inf, np.inf, (1,), np.float64)
        self.observation_space = spaces.Dict(observation=one, achieved_goal=one, desired_goal=one)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.n_steps, self.over = self.start, 0, False
        return self.observe(), {}

    def step(self, action):
        assert not self.over, "stepped after its end"
        self.place, self.n_steps = self.place + float(action[0]), self.n_steps + 1
        if self.place > self.nan_beyond:
            self.place = np.nan
        fell = self.place > self.edge
        arrived = bool(self.reached(np.array([self.place]), np.array([self.goal])))
        terminated, truncated = fell or (self.ends_at_goal and arrived), self.n_steps >= self.limit
        self.over = terminated or truncated
        return self.observe(), float(arrived) - 1.0, terminated, truncated, {"is_success": arrived}

    def observe(self):
        here = np.array([self.place])
        return {"observation": here, "achieved_goal": here.copy(), "desired_goal": np.array([self.goal])}

    def reached(self, achieved_goal, desired_goal):
        return np.abs(np.asarray(achieved_goal) - desired_goal)[..., 0] < REACH

    def compute_reward(self, achieved_goal, desired_goal, info):
        return self.reached(achieved_goal, desired_goal).astype(np.float32) - 1.0
