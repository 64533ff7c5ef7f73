"""A goal environment as the learner sees it: actions in [-1, 1], a reward of 0 at the goal, else -1."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from napsp.envs.success import SuccessTest


class GoalTask(gymnasium.Wrapper):
    """A goal environment with actions in [-1, 1], which are its whole box, and a reward of 0 at the goal, else -1.

    Args:
        env: with its wrappers; observes a Dict of three flat Boxes and acts by a flat Box with finite bounds.
        test: tells for pairs of goals ``(n, G)`` whether they are reached, bool ``(n,)``.
    """

    def __init__(self, env: gymnasium.Env, test: SuccessTest) -> None:
        super().__init__(env)
        box: Any = env.action_space
        self._low, self._high = box.low.astype(np.float64), box.high.astype(np.float64)
        self._type, self._test = box.dtype, test
        self.action_space = Box(-1.0, 1.0, box.shape, np.float32)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advance one control step."""
        observation, _, terminated, truncated, info = self.env.step(self.own_action(action))
        success = bool(self.reached(observation["achieved_goal"], observation["desired_goal"]))
        return observation, float(success) - 1.0, terminated, truncated, {**info, "is_success": success}

    def own_action(self, action: Any) -> np.ndarray:
        """An action ``(A,)`` in [-1, 1] as the environment's own, in its box."""
        share = 0.5 * (np.clip(np.asarray(action, np.float64), -1.0, 1.0) + 1.0)
        return np.clip(self._low + share * (self._high - self._low), self._low, self._high).astype(self._type)

    def reached(self, achieved_goal: np.ndarray, desired_goal: np.ndarray) -> np.ndarray:
        """Tell for each pair of goals ``(..., G)`` whether it is a success, bool ``(...)``."""
        pair = np.broadcast_arrays(achieved_goal, desired_goal)
        rows = [np.ascontiguousarray(goals).reshape(-1, goals.shape[-1]) for goals in pair]
        return self._test(*rows).reshape(pair[0].shape[:-1])

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> np.ndarray:
        """Sparse reward ``(...)``: 0 where reached, -1 elsewhere."""
        del info
        return self.reached(achieved_goal, desired_goal).astype(np.float32) - np.float32(1)
