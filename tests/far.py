"""Tasks far from the origin of their coordinates."""

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict


class FarPoint(gymnasium.Env):
    """A point in the plane that moves by its action, around ``offset`` in both coordinates; a success within 0.1."""

    max_episode_steps = 10
    observation_space = Dict({part: Box(-np.inf, np.inf, (2,), np.float64) for part in ("observation", "achieved_goal",
                                                                                       "desired_goal")})  # fmt: skip
    action_space = Box(-0.2, 0.2, (2,))

    def __init__(self, offset=1e6):
        self.offset = offset

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.goal = self.np_random.uniform(-1, 1, (2, 2)) + self.offset
        return self.observe(), {}

    def step(self, action):
        self.place = self.place + action
        return self.observe(), float(self.compute_reward(self.place, self.goal, {})), False, False, {}

    def observe(self):
        return {"observation": self.place, "achieved_goal": self.place, "desired_goal": self.goal}

    def compute_reward(self, achieved_goal, desired_goal, info):
        return -np.float32(np.linalg.norm(achieved_goal - desired_goal, axis=-1) > 0.1)


class NotSoFarPoint(FarPoint):
    def __init__(self):
        super().__init__(1e3)
