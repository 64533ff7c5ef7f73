"""Smoothing that knows nothing of the goal: what the CasADi layer has to beat."""

from __future__ import annotations

import numpy as np

from mpc.controller import Smoothed
from mpc.simulators import State


class LowPass:
    """First-order filter along the plan, beginning at the last executed action.

    Args:
        share: of the action before in each one, in [0, 1).
    """

    def __init__(self, share: float) -> None:
        self.share = share

    def reset(self) -> None:
        """Nothing is remembered."""

    def skip(self, steps: int) -> None:
        """Nothing is remembered."""

    def __call__(
        self, state: State, observation: dict[str, np.ndarray], actions: np.ndarray, executed: np.ndarray
    ) -> Smoothed:
        """The filtered plan ``(H, A)``; the search does not learn of it."""
        filtered = actions.copy()
        before = executed[-1] if len(executed) else actions[0]
        for t in range(len(filtered)):
            before = filtered[t] = self.share * before + (1.0 - self.share) * actions[t]
        return Smoothed(filtered, None, True)
