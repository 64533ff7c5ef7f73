"""The distance network d_theta(s, a, g)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from napsp.networks import InputScaling, mlp


class DistanceNetwork(nn.Module):
    """d_theta(s, a, g) in steps: how long from s to g when a is the first action.

    The network predicts d / T. ``forward`` returns the raw prediction that the losses fit
    (a linear output may be slightly negative); :meth:`steps` is the distance to use,
    clipped to [0, T].
    """

    def __init__(
        self, sizes: tuple[int, int, int], hidden: tuple[int, ...], horizon: int, output: str = "linear"
    ) -> None:
        super().__init__()
        n_observation, n_action, n_goal = sizes
        self.scaling = InputScaling(n_observation, n_goal)
        self.net = mlp(n_observation + n_action + n_goal, hidden, 1)
        self.horizon = horizon
        self.output = output

    def inputs(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        """What the network reads: scaled and joined rows ``(B, O + A + G)``."""
        observation, goal = self.scaling(observation, goal)
        return torch.cat([observation, action, goal], dim=-1)

    def fraction(self, outputs: Tensor) -> Tensor:
        """D / T from the outputs of the last layer, same shape."""
        return functional.softplus(outputs) if self.output == "softplus" else outputs

    def forward(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        """Raw prediction in steps ``(B,)`` for rows ``(B, O)``, ``(B, A)``, ``(B, G)``."""
        outputs = self.net(self.inputs(observation, action, goal))
        return self.fraction(outputs).squeeze(-1) * self.horizon

    def steps(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        """Distance in steps ``(B,)``, within [0, T]."""
        return self(observation, action, goal).clamp(0.0, self.horizon)
