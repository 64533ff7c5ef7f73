"""A policy's deterministic action, computed in numpy.

One state at a time, torch's call overhead costs many times the arithmetic, and a planner
asks between physics steps of a fraction of a millisecond.
"""

from __future__ import annotations

import numpy as np
from torch import Tensor, nn

from napsp.policy.actors import Policy
from napsp.scaling import Scaling


class GreedyPolicy:
    """a = pi(s, g) of a torch policy as it is now."""

    def __init__(self, policy: Policy) -> None:
        scaling = policy.scaling
        self._mean = np.concatenate([_numpy(scaling.observation_mean), _numpy(scaling.goal_mean)])
        self._scale = np.concatenate([_numpy(scaling.observation_scale), _numpy(scaling.goal_scale)])
        layers = [layer for layer in policy.net if isinstance(layer, nn.Linear)]
        self._layers = [(_numpy(layer.weight).T, _numpy(layer.bias)) for layer in layers]
        # SAC's output layer also gives the log standard deviations, which nobody needs here.
        weights, bias = self._layers[-1]
        self._layers[-1] = weights[:, : policy.n_actions], bias[: policy.n_actions]

    def __call__(self, observations: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Actions ``(B, A)`` in [-1, 1] for float32 observations ``(B, O)`` and goals ``(B, G)``."""
        inputs = np.concatenate([observations, goals], axis=-1)
        values = np.clip((inputs - self._mean) / self._scale, -Scaling.LIMIT, Scaling.LIMIT)
        for weights, bias in self._layers[:-1]:
            values = values @ weights + bias
            values = 0.5 * values * (1.0 + np.tanh(0.5 * values))  # SiLU, without exp's overflow
        weights, bias = self._layers[-1]
        return np.tanh(values @ weights + bias)


def _numpy(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy()
