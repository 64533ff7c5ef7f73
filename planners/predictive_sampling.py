"""Predictive sampling: noise around the best plan so far, and the best of it becomes the plan.

Howell et al. 2022, in numpy and nothing else: this file knows no simulator and no network. Run
it with ``python -m planners.predictive_sampling --env fetch_wall``.
"""

from __future__ import annotations

import numpy as np

from planners.sampling import best_plans, correlated_noise


class PredictiveSampling:
    """Searches plans of K knots with U controls each; lower cost is better.

    Args:
        n_knots: K.
        n_controls: U, each in [-1, 1].
        n_samples: N, plans per refinement.
        noise_scale: standard deviation of the noise, in control units.
        noise_correlation: correlation of the noise between neighbouring knots, in [0, 1).
    """

    def __init__(
        self,
        n_knots: int,
        n_controls: int,
        n_samples: int = 64,
        noise_scale: float = 0.8,
        noise_correlation: float = 0.6,
    ) -> None:
        self.n_samples, self.noise_scale, self.noise_correlation = n_samples, noise_scale, noise_correlation
        self._shape = (n_knots, n_controls)
        self.reset()

    def reset(self) -> None:
        """Forget the plan: the next episode starts from zero."""
        self.plan = np.zeros(self._shape)
        self.effective_samples = 1.0

    def sample(self, rng: np.random.Generator, proposals: np.ndarray | None = None) -> np.ndarray:
        """Draw knots ``(N, K, U)``: the plan, proposals ``(P, K, U)``, and noise around the plan."""
        noise = correlated_noise(rng, (self.n_samples, *self._shape), self.noise_correlation)
        knots = self.plan + self.noise_scale * noise
        first = np.concatenate([self.plan[None], *([] if proposals is None else [proposals])])[: self.n_samples]
        knots[: len(first)] = first
        return np.clip(knots, -1.0, 1.0)

    def update(self, knots: np.ndarray, costs: np.ndarray) -> None:
        """Take the best of ``knots`` ``(N, K, U)``; no finite cost keeps the plan."""
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

    main("predictive_sampling")
