"""The networks: distance d(s, a, g), squashed Gaussian policy, critics.

Every network takes raw inputs and scales them itself, so that a checkpoint is complete.
SiLU everywhere: the smoothing layer differentiates d (and the policy inside it) twice.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn
from torch.nn import functional

from napsp.scaling import Scaling

LOG_STD_RANGE = (-10.0, 2.0)


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


class Policy(nn.Module, ABC):
    """A policy pi(s, g) with actions in [-1, 1]^A; its first A outputs are the mode before tanh."""

    def __init__(self, sizes: tuple[int, int, int], hidden: tuple[int, ...], outputs_per_action: int) -> None:
        super().__init__()
        n_observation, self.n_actions, n_goal = sizes
        self.scaling = InputScaling(n_observation, n_goal)
        self.net = mlp(n_observation + n_goal, hidden, outputs_per_action * self.n_actions)

    def forward(self, observation: Tensor, goal: Tensor) -> Tensor:
        """Outputs of the network ``(B, outputs_per_action * A)``."""
        return self.net(torch.cat(self.scaling(observation, goal), dim=-1))

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
        return squash(outputs, torch.randn((len(outputs), self.n_actions), generator=generator))[0]


class DeterministicPolicy(Policy):
    """pi(s, g) of DDPG; explores with Gaussian noise on the action."""

    def __init__(self, sizes: tuple[int, int, int], hidden: tuple[int, ...], action_noise: float) -> None:
        super().__init__(sizes, hidden, outputs_per_action=1)
        self.action_noise = action_noise

    def explore(self, observation: Tensor, goal: Tensor, generator: torch.Generator) -> Tensor:
        """The action plus noise, clipped to [-1, 1] ``(B, A)``."""
        action = self.mode(observation, goal)
        noise = torch.randn(action.shape, generator=generator)
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
