"""The smoothing layer alone: ``python -m planners.smooth --env fetch_wall --start policy``.

There is no search. One plan is kept; every step it moves on in time, and the layer improves it.
"""

from __future__ import annotations

import numpy as np

from planners.predictive_sampling import PredictiveSampling


class Held(PredictiveSampling):
    """Keeps one plan of K knots with U controls, or takes a cheaper one that is proposed; adds no noise.

    Args:
        n_knots: K.
        n_controls: U, each in [-1, 1].
        start: ``policy`` also tries the proposals, ``zero`` begins at zero and does without.
    """

    def __init__(self, n_knots: int, n_controls: int, start: str = "policy") -> None:
        super().__init__(n_knots, n_controls)
        self._start = start

    def sample(self, rng: np.random.Generator, proposals: np.ndarray | None = None) -> np.ndarray:
        """The plan and, from the policy, proposals ``(P, K, U)``."""
        kept = [self.plan[None]]
        if proposals is not None and self._start == "policy":
            kept.append(proposals)
        return np.clip(np.concatenate(kept), -1.0, 1.0)


if __name__ == "__main__":
    from planners.app.cli import main

    main("smooth")
