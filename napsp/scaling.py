"""Fixed centre and scale of network and hash inputs."""

from __future__ import annotations

import numpy as np


class Scaling:
    """Fixed centre and scale of observations ``(O,)`` and goals ``(G,)``."""

    LIMIT = 10.0  # scaled inputs are clipped to +-LIMIT standard deviations
    NUMBERS = ("observation_mean", "observation_scale", "goal_mean", "goal_scale")

    def __init__(
        self,
        observation_mean: np.ndarray,
        observation_scale: np.ndarray,
        goal_mean: np.ndarray,
        goal_scale: np.ndarray,
    ) -> None:
        self.observation_mean, self.observation_scale = observation_mean, observation_scale
        self.goal_mean, self.goal_scale = goal_mean, goal_scale

    @classmethod
    def estimate(cls, observations: np.ndarray, goals: np.ndarray) -> Scaling:
        """Mean and standard deviation of rows ``(..., O)`` and ``(..., G)``."""
        return cls(*_moments(observations), *_moments(goals))

    def observation(self, observations: np.ndarray) -> np.ndarray:
        """Scaled observations, same shape."""
        scaled = (observations - self.observation_mean) / self.observation_scale
        return np.clip(scaled, -self.LIMIT, self.LIMIT)

    def goal(self, goals: np.ndarray) -> np.ndarray:
        """Scaled goals, same shape."""
        return np.clip((goals - self.goal_mean) / self.goal_scale, -self.LIMIT, self.LIMIT)


def _moments(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rows = rows.reshape(-1, rows.shape[-1]).astype(np.float64)
    scale = rows.std(0)
    # A constant input (Fetch's blocked fingers) carries nothing: leave it near zero rather
    # than blow its rounding errors up to size one.
    constant = scale < 1e-6 * np.maximum(1.0, np.abs(rows).max(0))
    return rows.mean(0).astype(np.float32), np.where(constant, 1.0, scale).astype(np.float32)
