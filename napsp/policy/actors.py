"""Policies pi(s, g): SAC's squashed Gaussian and DDPG's deterministic one."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator

import torch
from torch import Tensor, nn
from torch.nn import functional

from napsp.networks import InputScaling, first_linear, joined_columns, mlp

LOG_STD_RANGE = (-10.0, 2.0)


class Policy(nn.Module, ABC):
    """A policy pi(s, g) with actions in [-1, 1]^A; its first A outputs are the mode before tanh."""

    def __init__(self, sizes: tuple[int, int, int], hidden: tuple[int, ...], outputs_per_action: int) -> None:
        super().__init__()
        n_observation, self.n_actions, n_goal = self._sizes = sizes
        self.scaling = InputScaling(n_observation, n_goal)
        self.net = mlp(n_observation + n_goal, hidden, outputs_per_action * self.n_actions)

    def forward(self, observation: Tensor, goal: Tensor) -> Tensor:
        """Outputs of the network ``(B, outputs_per_action * A)`` for raw rows ``(B, O)`` and ``(B, G)``."""
        return self.outputs(*self.scaling(observation, goal))

    def outputs(self, observation: Tensor, goal: Tensor) -> Tensor:
        """The same for scaled rows."""
        return self.net(torch.cat([observation, goal], dim=-1))

    def readers(self) -> Iterator[tuple[nn.Linear, dict[str, slice]]]:
        """See :class:`napsp.networks.Scaled`."""
        yield first_linear(self.net), joined_columns(self._sizes[0], self._sizes[2])

    def mode(self, observation: Tensor, goal: Tensor) -> Tensor:
        """The deterministic action ``(B, A)``."""
        return torch.tanh(self(observation, goal)[..., : self.n_actions])

    @abstractmethod
    def explore(self, observation: Tensor, goal: Tensor, generator: torch.Generator) -> Tensor:
        """A random action ``(B, A)`` for collecting episodes."""


class GaussianPolicy(Policy):
    """pi(a | s, g) of SAC: a Gaussian squashed by tanh; outputs are mean and log deviation."""

    def __init__(self, sizes: tuple[int, int, int], hidden: tuple[int, ...]) -> None:
        super().__init__(sizes, hidden, outputs_per_action=2)

    def explore(self, observation: Tensor, goal: Tensor, generator: torch.Generator) -> Tensor:
        """A sample of the policy ``(B, A)``."""
        outputs = self(observation, goal)
        noise = torch.randn((len(outputs), self.n_actions), generator=generator, dtype=torch.float32)
        return squash(outputs, noise.to(outputs.device))[0]


class DeterministicPolicy(Policy):
    """pi(s, g) of DDPG; explores with Gaussian noise on the action."""

    def __init__(self, sizes: tuple[int, int, int], hidden: tuple[int, ...], action_noise: float) -> None:
        super().__init__(sizes, hidden, outputs_per_action=1)
        self.action_noise = action_noise

    def explore(self, observation: Tensor, goal: Tensor, generator: torch.Generator) -> Tensor:
        """The action plus noise, clipped to [-1, 1] ``(B, A)``."""
        action = self.mode(observation, goal)
        noise = torch.randn(action.shape, generator=generator, dtype=torch.float32).to(action.device)
        return (action + self.action_noise * noise).clamp(-1.0, 1.0)


def squash(outputs: Tensor, noise: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Sample a = tanh(mean + std * noise) from a Gaussian policy's outputs ``(B, 2 A)`` and normal noise ``(B, A)``.

    Returns:
        Actions ``(B, A)``, log densities ``(B,)`` and the log deviations ``(B, A)``.
    """
    mean, log_std = outputs.chunk(2, dim=-1)
    log_std = log_std.clamp(*LOG_STD_RANGE)
    before = mean + log_std.exp() * noise
    # log |d tanh(x) / dx| in the form that does not underflow for large |x|.
    squashing = 2.0 * (math.log(2.0) - before - functional.softplus(-2.0 * before))
    log_density = -0.5 * noise.square() - log_std - 0.5 * math.log(2 * math.pi) - squashing
    return torch.tanh(before), log_density.sum(-1), log_std
