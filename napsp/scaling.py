"""Fixed centre and scale of network and hash inputs."""

from __future__ import annotations

import numpy as np


class Scaling:
    """Fixed centre and scale of observations and goals, estimated once from episodes."""

    LIMIT = 10.0  # scaled inputs are clipped to +-LIMIT standard deviations

    def __init__(self, observations: np.ndarray, goals: np.ndarray) -> None:
        self.observation_mean, self.observation_scale = _moments(observations)
        self.goal_mean, self.goal_scale = _moments(goals)

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
