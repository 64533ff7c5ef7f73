"""The smoothing layer alone: ``python -m planners.smooth --env fetch_wall --start policy``.

There is no search. One plan is kept; every step it moves on in time, and the layer improves it.
"""

from __future__ import annotations

import numpy as np

from planners.sampling import best_plans


class Held:
    """Keeps one plan of K knots with U controls, or takes a cheaper one that is proposed.

    Args:
        n_knots: K.
        n_controls: U, each in [-1, 1].
        start: ``policy`` also tries the proposals, ``zero`` begins at zero and does without.
    """

    def __init__(self, n_knots: int, n_controls: int, start: str = "policy") -> None:
        self._shape, self._start = (n_knots, n_controls), start
        self.reset()

    def reset(self) -> None:
        """Forget the plan: the next episode starts from zero."""
        self.plan = np.zeros(self._shape)
        self.effective_samples = 1.0

    def sample(self, rng: np.random.Generator, proposals: np.ndarray | None = None) -> np.ndarray:
        """The plan and, from the policy, proposals ``(P, K, U)``."""
        kept = [self.plan[None]]
        if proposals is not None and self._start == "policy":
            kept.append(proposals)
        return np.clip(np.concatenate(kept), -1.0, 1.0)

    def update(self, knots: np.ndarray, costs: np.ndarray) -> None:
        """Take the cheapest of ``knots`` ``(N, K, U)``; no finite cost keeps the plan."""
        for index in best_plans(costs, 1):
            self.plan = knots[index]

    def shift(self, shift: np.ndarray) -> None:
        """Warm start: move the plan on by one control step with a matrix ``(K, K)``."""
        self.plan = shift @ self.plan


if __name__ == "__main__":
    from planners.cli import main

    main("smooth")
