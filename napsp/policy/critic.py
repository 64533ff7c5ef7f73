"""Critics Q(s, a, g)."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor, nn

from napsp.networks import InputScaling, first_linear, joined_columns, mlp


class Critic(nn.Module):
    """Independent action values Q(s, a, g): two for SAC, one or two for DDPG."""

    def __init__(self, sizes: tuple[int, int, int], hidden: tuple[int, ...], n_critics: int) -> None:
        super().__init__()
        self._sizes = sizes
        self.scaling = InputScaling(sizes[0], sizes[2])
        self.nets = nn.ModuleList([mlp(sum(sizes), hidden, 1) for _ in range(n_critics)])

    def forward(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        """All values ``(n, B)`` at raw rows ``(B, O)``, ``(B, A)``, ``(B, G)``."""
        observation, goal = self.scaling(observation, goal)
        return self.values(observation, action, goal)

    def values(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        """All values ``(n, B)`` at scaled rows."""
        inputs = torch.cat([observation, action, goal], dim=-1)
        return torch.stack([net(inputs).squeeze(-1) for net in self.nets])

    def first(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        """Values of the first critic ``(B,)`` at scaled rows."""
        return self.nets[0](torch.cat([observation, action, goal], dim=-1)).squeeze(-1)

    def readers(self) -> Iterator[tuple[nn.Linear, dict[str, slice]]]:
        """See :class:`napsp.networks.Scaled`."""
        for net in self.nets:
            yield first_linear(net), joined_columns(self._sizes[0], self._sizes[2])
