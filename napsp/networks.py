"""The networks: distance d(s, a, g), squashed Gaussian policy, critics.

Every network takes raw inputs and scales them itself, so that a checkpoint is complete.
SiLU everywhere: the smoothing layer differentiates d (and the policy inside it) twice.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import torch
from torch import Tensor, nn
from torch.nn import functional

from napsp.scaling import Scaling

LOG_STD_RANGE = (-10.0, 2.0)


def move_towards(parameters: Iterable[Tensor], goals: Iterable[Tensor], weight: float) -> None:
    """Polyak update in place: parameters += weight * (goals - parameters)."""
    with torch.no_grad():
        torch._foreach_lerp_(list(parameters), list(goals), weight)  # type: ignore[attr-defined]


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
        for name in ("observation_mean", "observation_scale", "goal_mean", "goal_scale"):
            getattr(self, name).copy_(torch.from_numpy(getattr(scaling, name)))

    def forward(self, observation: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
        """Scaled observation ``(B, O)`` and goal ``(B, G)``."""
        limit = Scaling.LIMIT
        return (
            ((observation - self.observation_mean) / self.observation_scale).clamp(-limit, limit),
            ((goal - self.goal_mean) / self.goal_scale).clamp(-limit, limit),
        )


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

    def forward(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        """Raw prediction in steps ``(B,)`` for rows ``(B, O)``, ``(B, A)``, ``(B, G)``."""
        observation, goal = self.scaling(observation, goal)
        fraction = self.net(torch.cat([observation, action, goal], dim=-1)).squeeze(-1)
        if self.output == "softplus":
            fraction = functional.softplus(fraction)
        return fraction * self.horizon

    def steps(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        """Distance in steps ``(B,)``, within [0, T]."""
        return self(observation, action, goal).clamp(0.0, self.horizon)


class Critic(nn.Module):
    """Two independent action values Q(s, a, g); returns ``(2, B)``."""

    def __init__(self, sizes: tuple[int, int, int], hidden: tuple[int, ...]) -> None:
        super().__init__()
        n_observation, n_action, n_goal = sizes
        self.scaling = InputScaling(n_observation, n_goal)
        self.nets = nn.ModuleList([mlp(n_observation + n_action + n_goal, hidden, 1) for _ in range(2)])

    def forward(self, observation: Tensor, action: Tensor, goal: Tensor) -> Tensor:
        """Both values, ``(2, B)``."""
        observation, goal = self.scaling(observation, goal)
        inputs = torch.cat([observation, action, goal], dim=-1)
        return torch.stack([net(inputs).squeeze(-1) for net in self.nets])


class GaussianPolicy(nn.Module):
    """pi(a | s, g): a Gaussian squashed by tanh into [-1, 1]^A."""

    def __init__(self, sizes: tuple[int, int, int], hidden: tuple[int, ...]) -> None:
        super().__init__()
        n_observation, n_action, n_goal = sizes
        self.scaling = InputScaling(n_observation, n_goal)
        self.net = mlp(n_observation + n_goal, hidden, 2 * n_action)

    def forward(self, observation: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log standard deviation before squashing, ``(B, A)`` each."""
        observation, goal = self.scaling(observation, goal)
        mean, log_std = self.net(torch.cat([observation, goal], dim=-1)).chunk(2, dim=-1)
        return mean, log_std.clamp(*LOG_STD_RANGE)

    def mode(self, observation: Tensor, goal: Tensor) -> Tensor:
        """The deterministic action ``(B, A)``."""
        return torch.tanh(self(observation, goal)[0])

    def sample(self, observation: Tensor, goal: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """A reparametrised action ``(B, A)`` and its log density ``(B,)``."""
        mean, log_std = self(observation, goal)
        noise = torch.randn(mean.shape, generator=generator)
        before = mean + log_std.exp() * noise
        log_density = (-0.5 * noise.square() - log_std - 0.5 * math.log(2 * math.pi)).sum(-1)
        # log |d tanh(x) / dx| in the form that does not underflow for large |x|.
        squash = 2.0 * (math.log(2.0) - before - functional.softplus(-2.0 * before))
        return torch.tanh(before), log_density - squash.sum(-1)
