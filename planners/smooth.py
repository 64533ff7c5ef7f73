"""The smoothing layer alone: ``python -m planners.smooth --env fetch_wall --search.start policy``.

There is no search. One plan is kept; every step it moves on in time, and the layer improves it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from planners.sampling import best_plans


@dataclass(frozen=True)
class HeldConfig:
    """Keep one plan: what the smoothing layer begins with."""

    start: Literal["policy", "zero"] = "policy"
    """What is smoothed: the cheapest of the last plan and what is proposed, such as the policy's own rollout, or the
    last plan only, which starts at zero."""

    @property
    def samples(self) -> int:
        """The plan and a proposal; there is no noise, so there is nothing to choose."""
        return 2

    @property
    def refinements(self) -> int:
        """One: the same plans again would cost the same."""
        return 1

    def least_samples(self, n_proposals: int) -> int:
        """The plan that is kept is enough."""
        return 1

    def __post_init__(self) -> None:
        if self.start not in ("policy", "zero"):
            raise ValueError(f"start is {self.start!r}; choose policy or zero")


class Held:
    """Keeps one plan of K knots with U controls, or takes a cheaper one that is proposed; adds no noise.

    Args:
        n_knots: K.
        n_controls: U, each in [-1, 1].
        config: what to begin with.
    """

    def __init__(self, n_knots: int, n_controls: int, config: HeldConfig | None = None) -> None:
        self.config = config or HeldConfig()
        self._shape = (n_knots, n_controls)
        self.reset()

    def reset(self) -> None:
        """Forget the plan: the next episode starts from zero."""
        self.plan = np.zeros(self._shape)
        self.effective_samples = 1.0

    def sample(self, rng: np.random.Generator, proposals: np.ndarray | None = None) -> np.ndarray:
        """The plan and, unless it starts at zero, proposals ``(P, K, U)``."""
        kept = [self.plan[None]]
        if proposals is not None and self.config.start == "policy":
            kept.append(proposals)
        return np.clip(np.concatenate(kept), -1.0, 1.0)

    def update(self, knots: np.ndarray, costs: np.ndarray) -> None:
        """Take the best of ``knots`` ``(P + 1, K, U)``; no finite cost keeps the plan."""
        for index in best_plans(costs, 1):
            self.plan = knots[index]

    def adopt(self, knots: np.ndarray) -> None:
        """Go on from this plan ``(K, U)``."""
        self.plan = knots

    def shift(self, shift: np.ndarray) -> None:
        """Warm start: move the plan on by one control step with a matrix ``(K, K)``."""
        self.plan = shift @ self.plan


if __name__ == "__main__":
    from planners.app.cli import main

    main("smooth")
