"""A batch of episodes, and what judges them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Episodes:
    """A batch of E episodes of T steps, float32.

    Attributes:
        observations: s_0 .. s_T, ``(E, T + 1, O)``.
        achieved_goals: phi(s_0) .. phi(s_T), ``(E, T + 1, G)``.
        actions: a_0 .. a_{T-1}, ``(E, T, A)``.
        desired_goals: the goal the episode was collected for, ``(E, G)``.
    """

    observations: np.ndarray
    achieved_goals: np.ndarray
    actions: np.ndarray
    desired_goals: np.ndarray

    def __len__(self) -> int:
        return len(self.actions)

    def __getitem__(self, part: slice) -> Episodes:
        return Episodes(*(getattr(self, name)[part] for name in FIELDS))


SparseReward = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Maps achieved goals ``(n, G)`` and goals ``(n, G)`` to rewards ``(n,)``: 0 where reached, else -1."""


FIELDS = ("observations", "achieved_goals", "actions", "desired_goals")


def concatenate(parts: list[Episodes]) -> Episodes:
    """Join batches of episodes."""
    return Episodes(*(np.concatenate([getattr(part, name) for part in parts]) for name in FIELDS))
