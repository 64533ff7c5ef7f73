"""What the policy learners share: their batch, their interface, and the range of values."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Protocol

import torch
from torch import Tensor

from napsp.backprop import Adam
from napsp.config import TrainConfig
from napsp.policy.actors import Policy


@dataclass(frozen=True)
class PolicyBatch:
    """B goal-relabelled transitions; observations and goals are scaled for the networks.

    Attributes:
        observations: ``(B, O)``.
        actions: ``(B, A)``.
        next_observations: ``(B, O)``.
        goals: ``(B, G)``.
        rewards: ``(B,)``.
    """

    observations: Tensor
    actions: Tensor
    next_observations: Tensor
    goals: Tensor
    rewards: Tensor

    def split(self, size: int) -> list[PolicyBatch]:
        """Batches of ``size`` transitions."""
        parts = [getattr(self, field.name).split(size) for field in fields(self)]
        return [PolicyBatch(*part) for part in zip(*parts, strict=True)]


class Agent(Protocol):
    """A policy with what trains it; see :class:`napsp.policy.sac.SAC` and :class:`napsp.policy.ddpg.DDPG`."""

    policy: Policy
    optimizers: dict[str, Adam]

    def update(self, batch: PolicyBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """One gradient step of everything; returns scalars to log."""
        ...

    def networks(self) -> dict[str, torch.nn.Module]:
        """All networks by name."""
        ...

    def tensors(self) -> dict[str, Tensor]:
        """What else belongs to the agent's state."""
        ...


def critic_targets_range(config: TrainConfig) -> tuple[float, float]:
    """Returns of rewards in [-1, 0] stay in this interval; bootstrapped targets could leave it."""
    return (-1.0 / (1.0 - config.discount), 0.0) if config.clip_values else (-math.inf, math.inf)
