"""d_theta and d_theta_old: reading distances in bulk and fitting them to labels."""

from __future__ import annotations

import copy

import numpy as np
import torch
from torch import Tensor

from napsp.backprop import Adam, Backprop, flatten
from napsp.compiled import compiled
from napsp.config import TrainConfig
from napsp.distance.labels import squared_error
from napsp.distance.network import DistanceNetwork

CHUNK = 1024  # rows per forward pass: larger ones fall out of the cache


class DistanceRegression:
    """The distance network, its frozen copy, and gradient steps towards labels (eq. 4a, 4b)."""

    def __init__(self, sizes: tuple[int, int, int], config: TrainConfig) -> None:
        self.distance = DistanceNetwork(sizes, config.hidden, config.horizon, config.distance_output)
        self.target_distance = copy.deepcopy(self.distance)
        self._vector, self._target_vector = flatten([self.distance]), flatten([self.target_distance])
        self.optimizer = Adam(self._vector, config.distance_learning_rate)
        self._backprop = Backprop(self.distance.net, self._vector)
        self._target_backprop = Backprop(self.target_distance.net, self._target_vector)
        self._softplus, self._polyak = config.distance_output == "softplus", config.target_polyak
        self._slow, self._batch_size = config.slow_distance, config.batch_size
        self._step = compiled(self._gradient_step, config.compiled)

    @property
    def trusted(self) -> DistanceNetwork:
        """The network that rewards the policy: d_theta or its slow copy."""
        return self.target_distance if self._slow else self.distance

    @torch.no_grad()
    def inputs(self, observations: np.ndarray, actions: np.ndarray, goals: np.ndarray) -> Tensor:
        """Scaled and joined network inputs ``(B, O + A + G)`` from raw rows."""
        return self.distance.inputs(*map(torch.from_numpy, (observations, actions, goals)))

    def steps(self, inputs: Tensor) -> Tensor:
        """Distance to use ``(B,)`` in steps, within [0, T], of rows of :meth:`inputs`: d_theta or its slow copy."""
        return self._steps(self._target_backprop if self._slow else self._backprop, inputs)

    def target_steps(self, inputs: Tensor) -> Tensor:
        """d_theta_old ``(B,)`` in steps, within [0, T], of rows of :meth:`inputs`."""
        return self._steps(self._target_backprop, inputs)

    @torch.no_grad()
    def fit(self, inputs: Tensor, labels: Tensor, n_sampled: int, weight: float = 1.0) -> tuple[Tensor, Tensor]:
        """One gradient step of ``weight`` times the squared error against labels ``(B,)`` in steps.

        Returns:
            The loss and the predictions ``(B,)`` in steps before it.
        """
        # Eq. 4a; how many tuples of eq. 4b pass its test differs, and each number would be a program of its own.
        whole = len(inputs) == n_sampled == self._batch_size and weight == 1.0
        return (self._step if whole else self._gradient_step)(inputs, labels, n_sampled, weight)

    def _gradient_step(self, inputs: Tensor, labels: Tensor, n_sampled: int, weight: float) -> tuple[Tensor, Tensor]:
        outputs, tape = self._backprop.forward(inputs)
        fractions = self.distance.fraction(outputs).squeeze(1)
        loss, gradient = squared_error(fractions, labels / self.distance.horizon, n_sampled)
        if self._softplus:
            gradient = gradient * torch.sigmoid(outputs.squeeze(1))
        slopes = self._backprop.slopes(tape, (weight * gradient).unsqueeze(1))
        self.optimizer.update(self._backprop.gradients(tape, slopes))
        return loss, fractions * self.distance.horizon

    @torch.no_grad()
    def _steps(self, backprop: Backprop, inputs: Tensor) -> Tensor:
        fractions = [self.distance.fraction(backprop.forward(part)[0]).squeeze(1) for part in inputs.split(CHUNK)]
        return (torch.cat(fractions) * self.distance.horizon).clamp(0.0, self.distance.horizon)

    def update_target(self) -> None:
        """Algorithm 1, line 9: theta_old <- theta (or a Polyak step towards it)."""
        self._target_vector.lerp_(self._vector, self._polyak)
