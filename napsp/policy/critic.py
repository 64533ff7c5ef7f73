"""Critics Q(s, a, g)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from napsp.networks import InputScaling, mlp


class Critic(nn.Module):
    """Independent action values Q(s, a, g): two for SAC, one for DDPG; returns ``(n, B)``."""

    def __init__(self, sizes: tuple[int, int, int], hidden: tuple[int, ...], n_critics: int) -> None:
        super().__init__()
        n_observation, n_action, n_goal = sizes
        self.scaling = InputScaling(n_observation, n_goal)
        self.nets = nn.ModuleList([mlp(n_observation + n_action + n_goal, hidden, 1) for _ in range(n_critics)])

    def forward(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        """All values, ``(n, B)``."""
        observation, goal = self.scaling(observation, goal)
        inputs = torch.cat([observation, action, goal], dim=-1)
        return torch.stack([net(inputs).squeeze(-1) for net in self.nets])
