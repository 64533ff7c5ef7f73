"""The networks: distance d(s, a, g), squashed Gaussian policy, critics.

Every network takes raw inputs and scales them itself, so that a checkpoint is complete.
SiLU everywhere: the smoothing layer differentiates d (and the policy inside it) twice.
"""

from __future__ import annotations

import itertools

import torch
from torch import Tensor, nn

from napsp.scaling import Scaling


def mlp(n_inputs: int, hidden: tuple[int, ...], n_outputs: int) -> nn.Sequential:
    """Fully connected network with SiLU between its linear layers."""
    widths = [n_inputs, *hidden]
    layers: list[nn.Module] = []
    for before, after in itertools.pairwise(widths):
        layers += [nn.Linear(before, after), nn.SiLU()]
    return nn.Sequential(*layers, nn.Linear(widths[-1], n_outputs))


class InputScaling(nn.Module):
    """Fixed centre and scale of observation and goal, stored with the weights."""

    def __init__(self, n_observation: int, n_goal: int) -> None:
        super().__init__()
        self.observation_mean = nn.Buffer(torch.zeros(n_observation))
        self.observation_scale = nn.Buffer(torch.ones(n_observation))
        self.goal_mean = nn.Buffer(torch.zeros(n_goal))
        self.goal_scale = nn.Buffer(torch.ones(n_goal))

    def set(self, scaling: Scaling) -> None:
        """Copy the numbers of a numpy :class:`Scaling`."""
        for name, values in vars(scaling).items():
            getattr(self, name).copy_(torch.from_numpy(values))

    def numbers(self) -> Scaling:
        """The numpy :class:`Scaling` with the same numbers."""
        return Scaling(*(getattr(self, name).numpy().copy() for name in Scaling.NUMBERS))

    def forward(self, observation: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
        """Scaled observation ``(B, O)`` and goal ``(B, G)``."""
        limit = Scaling.LIMIT
        return (
            ((observation - self.observation_mean) / self.observation_scale).clamp(-limit, limit),
            ((goal - self.goal_mean) / self.goal_scale).clamp(-limit, limit),
        )


@torch.no_grad()
def rescale(network: nn.Module, scaling: Scaling) -> None:
    """Give a network another input scaling and the same function (where nothing is clipped).

    Its first layers must read observations in their first columns and goals in their last.
    """
    old: InputScaling = network.scaling  # type: ignore[assignment]
    n_observation, n_goal = len(scaling.observation_mean), len(scaling.goal_mean)
    parts = {"observation": slice(0, n_observation), "goal": slice(-n_goal, None)}
    for net in getattr(network, "nets", None) or [network.net]:  # type: ignore[union-attr]
        for name, columns in parts.items():
            mean, scale = (torch.from_numpy(getattr(scaling, f"{name}_{part}")) for part in ("mean", "scale"))
            old_mean, old_scale = getattr(old, f"{name}_mean"), getattr(old, f"{name}_scale")
            first = next(layer for layer in net.modules() if isinstance(layer, nn.Linear))
            weight = first.weight[:, columns]
            first.bias += weight @ ((mean - old_mean) / old_scale)
            weight *= scale / old_scale
    old.set(scaling)
