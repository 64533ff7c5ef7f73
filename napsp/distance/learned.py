"""d_theta and d_theta_old: reading distances in bulk and fitting them to labels."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from napsp.distance.losses import LOSSES, Labelled
from napsp.distance.network import DistanceConfig, DistanceNetwork
from napsp.execution import Execution, Slow, descend
from napsp.networks import rescale
from napsp.scaling import Scaling

CHUNK = 1024  # rows per forward pass: larger ones fall out of the cache


class LearnedDistance:
    """The distance network, its frozen copy, and gradient steps towards labels (eq. 4a, 4b).

    Args:
        sizes: of observation, action and goal.
        hidden: widths of the hidden layers.
        episode_length: T.
        batch_size: of the updates worth a program of their own.
        config: the network and its loss.
        execution: device and so on.
    """

    def __init__(
        self,
        sizes: tuple[int, int, int],
        hidden: tuple[int, ...],
        episode_length: int,
        batch_size: int,
        config: DistanceConfig,
        execution: Execution,
    ) -> None:
        self._device = execution.torch_device
        self.distance = DistanceNetwork(sizes, hidden, episode_length, config).to(self._device)
        self._slow = Slow(self.distance, config.target_polyak)
        self.target_distance = self._slow.network
        self.optimizer = execution.adam(self.distance.parameters(), config.learning_rate)
        self._config, self._batch_size = config, batch_size
        self._loss = LOSSES[config.loss]
        self._whole_loss = execution.loss(self._loss)
        self._whole_update = execution.update(self._update_whole)

    @property
    def trusted(self) -> DistanceNetwork:
        """The network that rewards the policy: d_theta or its slow copy."""
        return self.target_distance if self._config.slow else self.distance

    @torch.no_grad()
    def rows(self, observations: np.ndarray, actions: np.ndarray, goals: np.ndarray) -> Tensor:
        """Scaled and joined network inputs ``(B, O + A + G)`` from raw ones; a phase's samples move here, once."""
        raw = (torch.from_numpy(part).to(self._device) for part in (observations, actions, goals))
        return self.distance.inputs(*raw)

    def steps(self, rows: Tensor) -> Tensor:
        """Distance to use ``(B,)`` in steps, within [0, T]: d_theta or its slow copy."""
        return self._steps(self.trusted, rows)

    def target_steps(self, rows: Tensor) -> Tensor:
        """d_theta_old ``(B,)`` in steps, within [0, T]."""
        return self._steps(self.target_distance, rows)

    def fit(self, rows: Tensor, labels: Tensor, n_sampled: int, weight: float = 1.0) -> tuple[Tensor, Tensor]:
        """One gradient step of ``weight`` times the loss against labels ``(B,)`` in steps.

        Returns:
            The loss and the predictions ``(B,)`` in steps before it.
        """
        # Eq. 4a; how many tuples of eq. 4b pass its test differs, and each number would be a program of its own.
        if len(rows) == n_sampled == self._batch_size and weight == 1.0:
            found = self._whole_update(rows, labels)
            return found["loss"], found["predictions"]
        loss, metrics = self._loss(self.distance, Labelled(rows, labels, n_sampled))
        descend(weight * loss, self.optimizer)
        return loss.detach(), metrics["predictions"]

    def _update_whole(self, rows: Tensor, labels: Tensor) -> dict[str, Tensor]:
        loss, metrics = self._whole_loss(self.distance, Labelled(rows, labels, self._batch_size))
        descend(loss, self.optimizer)
        return {"loss": loss.detach(), **metrics}

    @torch.no_grad()
    def _steps(self, network: DistanceNetwork, rows: Tensor) -> Tensor:
        parts = rows.split(CHUNK) if self._device.type == "cpu" else [rows]
        fractions = torch.cat([network.fractions(part) for part in parts])
        return (fractions * network.episode_length).clamp(0.0, network.episode_length)

    def update_target(self) -> None:
        """Algorithm 1, line 9: theta_old <- theta (or a Polyak step towards it)."""
        self._slow.follow()

    def rescale(self, scaling: Scaling) -> None:
        """Read inputs under another scaling, with the same distances."""
        for network in (self.distance, self.target_distance):
            rescale(network, scaling)

    def networks(self) -> dict[str, torch.nn.Module]:
        """All networks by name."""
        return {"distance": self.distance, "target_distance": self.target_distance}
