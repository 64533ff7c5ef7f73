"""Small learners and a batch for them."""

import torch

from napsp.distance.learned import LearnedDistance
from napsp.distance.network import DistanceConfig
from napsp.execution import Execution
from napsp.policy.agent import PolicyBatch

SIZES, HIDDEN = (5, 2, 3), (32, 16)


def batch(n=64):
    generator = torch.Generator().manual_seed(1)
    rows = [torch.randn(n, size, generator=generator) for size in (5, 2, 5, 3)]
    return PolicyBatch(
        rows[0], rows[1].tanh(), rows[2], rows[3], -torch.rand(n, generator=generator), torch.full((n,), torch.nan)
    )


def rows_of(transitions):
    return torch.cat([transitions.observations, transitions.actions, transitions.goals], dim=1)


def learned(execution=None, **options):
    torch.manual_seed(0)
    return LearnedDistance(SIZES, HIDDEN, 50, 64, DistanceConfig(**options), execution or Execution())
