"""What the policy learners share: their options, their batch, and their interface."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from napsp.networks import InputScaling
from napsp.policy.actors import Policy
from napsp.scaling import Scaling
from napsp.settings import MANY, TINY, check_ranges


@dataclass(frozen=True)
class PolicyConfig:
    """Learner of the policy."""

    agent: str = "sac"
    """sac, or ddpg (the paper's for pick-and-place)."""
    learning_rate: float = 1e-3
    """Adam's step size of actor and critics."""
    discount: float = 0.98
    """Discount of the policy's return."""
    polyak: float = 0.01
    """Weight of the new parameters in the slow copies of critics and policy, per update."""
    slow: bool = False
    """Evaluate, save and plan with the slow copy of the policy, which DDPG and plus have; the trained one collects.
    Where one action changes d by a small share of it, the trained one swings from update to update."""
    clip_values: bool = True
    """Clip the critics' targets to [-1 / (1 - discount), 0], where the rewards alone would keep them."""
    entropy_weight: float | None = None
    """Fixed SAC alpha, in units of reward; None adapts it to a target entropy of minus the action size."""
    min_entropy_weight: float = 0.02
    """Floor of the adapted SAC alpha, in lost steps per nat, the same for every method: a nat of entropy is worth that
    many steps. A lost step costs a return of 1 with the sparse reward, and of 1 / (T (1 - discount)) with -d / T."""
    action_noise: float = 0.2
    """Standard deviation of DDPG's exploration noise; actions lie in [-1, 1]."""
    clipped_double_q: bool = False
    """Two critics for DDPG, which learn from the smaller of their values; SAC always has them."""
    action_penalty: float = 1.0
    """Weight of the mean squared action in DDPG's policy loss (HER's action_l2)."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            learning_rate=(TINY, 1),
            discount=(0, 1 - 1e-6),
            polyak=(TINY, 1),
            entropy_weight=(TINY, MANY),
            min_entropy_weight=(TINY, MANY),
            action_noise=(0, 100),
            action_penalty=(0, MANY),
        )

    @property
    def values_range(self) -> tuple[float, float]:
        """Returns of rewards in [-1, 0] stay in this interval; bootstrapped targets could leave it."""
        return (-1.0 / (1.0 - self.discount), 0.0) if self.clip_values else (-math.inf, math.inf)


class PolicyBatch(NamedTuple):
    """B goal-relabelled transitions, raw or, inside an agent, scaled for the networks.

    Attributes:
        observations: ``(B, O)``.
        actions: ``(B, A)``.
        next_observations: ``(B, O)``.
        goals: ``(B, G)``.
        rewards: ``(B,)``.
        ended: share of all later reward that is lost where nothing follows the next state, ``(B,)``; NaN where the
            world goes on, as it does beyond a time limit. See :class:`napsp.policy.her.Transitions`.
    """

    observations: Tensor
    actions: Tensor
    next_observations: Tensor
    goals: Tensor
    rewards: Tensor
    ended: Tensor

    def split(self, size: int) -> list[PolicyBatch]:
        """Batches of ``size`` transitions (views)."""
        return [PolicyBatch(*part) for part in zip(*(rows.split(size) for rows in self), strict=True)]

    def targets(self, next_values: Tensor, discount: float, limits: tuple[float, float]) -> Tensor:
        """What critics learn ``(B,)``: r + discount * V(s'), within ``limits``.

        Where nothing follows s', V(s') is 0 at the goal and -1 / (1 - discount), the value of never reaching it,
        elsewhere: with 0 there, an early end would be the cheapest way.
        """
        final = -self.ended / (1.0 - discount)
        values = torch.where(self.ended.isnan(), next_values, final)
        return (self.rewards + discount * values).clamp(*limits)

    def scaled(self, scaling: InputScaling) -> PolicyBatch:
        """The same as the networks read it, on their device."""
        device = scaling.observation_mean.device
        observations, actions, next_observations, goals, rewards, ended = (rows.to(device) for rows in self)
        return PolicyBatch(
            scaling(observations, goals)[0], actions, scaling(next_observations, goals)[0],
            scaling(observations, goals)[1], rewards, ended,
        )  # fmt: skip


class Agent(Protocol):
    """A policy with what trains it; see :class:`napsp.policy.sac.SAC` and :class:`napsp.policy.ddpg.DDPG`."""

    optimizers: dict[str, torch.optim.Adam]

    @property
    def policy(self) -> Policy:
        """What is trained, and collects episodes."""
        ...

    @property
    def trusted(self) -> Policy:
        """What is evaluated and saved: the policy, or with ``policy.slow`` its slow copy."""
        ...

    def train(self, transitions: Any, batch_size: int, generator: torch.Generator) -> dict[str, float]:
        """Update everything once per batch of raw transitions ``(n * batch_size, .)``; figures to log.

        Transitions are a :class:`PolicyBatch`, or what else the agent learns from.
        """
        ...

    def rescale(self, scaling: Scaling) -> None:
        """Read inputs under another scaling, with the same actions and values."""
        ...

    def networks(self) -> dict[str, torch.nn.Module]:
        """All networks by name."""
        ...

    def tensors(self) -> dict[str, Tensor]:
        """What else belongs to the agent's state."""
        ...
