"""d_theta and d_theta_old: reading distances in bulk and fitting them to labels."""

from __future__ import annotations

import copy

import numpy as np
import torch
from torch import Tensor

from napsp.backprop import Backprop, adam, flatten
from napsp.config import TrainConfig
from napsp.losses import squared_error
from napsp.networks import DistanceNetwork

CHUNK = 1024  # rows per forward pass: larger ones fall out of the cache


class DistanceRegression:
    """The distance network, its frozen copy, and gradient steps towards labels (eq. 4a, 4b)."""

    def __init__(self, sizes: tuple[int, int, int], config: TrainConfig) -> None:
        self.distance = DistanceNetwork(sizes, config.hidden, config.horizon, config.distance_output)
        self.target_distance = copy.deepcopy(self.distance)
        self._vector, self._target_vector = flatten([self.distance]), flatten([self.target_distance])
        self.optimizer = adam(self._vector, config.distance_learning_rate)
        self._backprop = Backprop(self.distance.net)
        self._softplus, self._polyak = config.distance_output == "softplus", config.target_polyak
        self.trusted = self.target_distance if config.slow_distance else self.distance

    @torch.no_grad()
    def inputs(self, observations: np.ndarray, actions: np.ndarray, goals: np.ndarray) -> Tensor:
        """Scaled and joined network inputs ``(B, O + A + G)`` from raw rows."""
        return self.distance.inputs(*map(torch.from_numpy, (observations, actions, goals)))

    def steps(self, inputs: Tensor) -> Tensor:
        """Distance to use ``(B,)`` in steps, within [0, T], of rows of :meth:`inputs`: d_theta or its slow copy."""
        return _steps(self.trusted, inputs)

    def target_steps(self, inputs: Tensor) -> Tensor:
        """d_theta_old ``(B,)`` in steps, within [0, T], of rows of :meth:`inputs`."""
        return _steps(self.target_distance, inputs)

    @torch.no_grad()
    def fit(self, inputs: Tensor, labels: Tensor, n_sampled: int, weight: float = 1.0) -> tuple[Tensor, Tensor]:
        """One gradient step of ``weight`` times the squared error against labels ``(B,)`` in steps.

        Returns:
            The loss and the predictions ``(B,)`` in steps before it.
        """
        outputs, tape = self._backprop.forward(inputs)
        fractions = self.distance.fraction(outputs).squeeze(1)
        loss, gradient = squared_error(fractions, labels / self.distance.horizon, n_sampled)
        if self._softplus:
            gradient = gradient * torch.sigmoid(outputs.squeeze(1))
        self._backprop.backward(tape, (weight * gradient).unsqueeze(1))
        self.optimizer.step()
        return loss, fractions * self.distance.horizon

    def update_target(self) -> None:
        """Algorithm 1, line 9: theta_old <- theta (or a Polyak step towards it)."""
        self._target_vector.lerp_(self._vector, self._polyak)


@torch.no_grad()
def _steps(network: DistanceNetwork, inputs: Tensor) -> Tensor:
    fractions = [network.fraction(network.net(part)).squeeze(1) for part in inputs.split(CHUNK)]
    return (torch.cat(fractions) * network.horizon).clamp(0.0, network.horizon)
