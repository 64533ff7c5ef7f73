"""What all networks are made of: layers, and the scaling of their inputs.

Every network takes raw inputs and scales them itself, so that a checkpoint is complete.
SiLU everywhere: the smoothing layer differentiates d (and the policy inside it) twice.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Protocol

import torch
from torch import Tensor, nn

from napsp.scaling import Scaling


def mlp(n_inputs: int, hidden: tuple[int, ...], n_outputs: int, layer_norm: bool = False) -> nn.Sequential:
    """Fully connected network with SiLU, after a layer norm if wanted, between its linear layers."""
    widths = [n_inputs, *hidden]
    layers: list[nn.Module] = []
    for before, after in itertools.pairwise(widths):
        norm = [nn.LayerNorm(after, dtype=torch.float32)] if layer_norm else []
        layers += [nn.Linear(before, after, dtype=torch.float32), *norm, nn.SiLU()]
    return nn.Sequential(*layers, nn.Linear(widths[-1], n_outputs, dtype=torch.float32))


class InputScaling(nn.Module):
    """Fixed centre and scale of observation and goal, stored with the weights."""

    def __init__(self, n_observation: int, n_goal: int) -> None:
        super().__init__()
        self.observation_mean = nn.Buffer(torch.zeros(n_observation, dtype=torch.float32))
        self.observation_scale = nn.Buffer(torch.ones(n_observation, dtype=torch.float32))
        self.goal_mean = nn.Buffer(torch.zeros(n_goal, dtype=torch.float32))
        self.goal_scale = nn.Buffer(torch.ones(n_goal, dtype=torch.float32))

    def set(self, scaling: Scaling) -> None:
        """Copy the numbers of a numpy :class:`Scaling`."""
        for name, values in vars(scaling).items():
            getattr(self, name).copy_(torch.from_numpy(values))

    def numbers(self) -> Scaling:
        """The numpy :class:`Scaling` with the same numbers."""
        return Scaling(*(getattr(self, name).cpu().numpy().copy() for name in Scaling.NUMBERS))

    def forward(self, observation: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
        """Scaled observation ``(B, O)`` and goal ``(B, G)``."""
        limit = Scaling.LIMIT
        return (
            ((observation - self.observation_mean) / self.observation_scale).clamp(-limit, limit),
            ((goal - self.goal_mean) / self.goal_scale).clamp(-limit, limit),
        )


class Scaled(Protocol):
    """A network that scales its own inputs."""

    scaling: InputScaling

    def readers(self) -> Iterator[tuple[nn.Linear, dict[str, slice]]]:
        """Every layer that reads scaled inputs, with the columns where it reads ``observation`` and ``goal``."""
        ...


def first_linear(net: nn.Module) -> nn.Linear:
    """The layer of a network that reads its inputs."""
    return next(layer for layer in net.modules() if isinstance(layer, nn.Linear))


def joined_columns(n_observation: int, n_goal: int) -> dict[str, slice]:
    """Where joined inputs, ``(observation, ..., goal)``, hold what is scaled."""
    return {"observation": slice(0, n_observation), "goal": slice(-n_goal, None)}


@torch.no_grad()
def rescale(network: Scaled, scaling: Scaling) -> None:
    """Give a network another input scaling and the same function (where nothing is clipped)."""
    old = network.scaling
    for first, columns in network.readers():
        for name, part in columns.items():
            mean, scale = (torch.from_numpy(getattr(scaling, f"{name}_{what}")) for what in ("mean", "scale"))
            old_mean, old_scale = getattr(old, f"{name}_mean"), getattr(old, f"{name}_scale")
            weight = first.weight[:, part]
            first.bias += weight @ ((mean.to(weight.device) - old_mean) / old_scale)
            weight *= scale.to(weight.device) / old_scale
    old.set(scaling)
