"""Predictive sampling: noise around the best plan so far, and the best of it becomes the plan.

Howell et al. 2022, in numpy and nothing else: this file knows no simulator and no network. Run
it with ``python -m planners.predictive_sampling --env fetch_wall``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.sampling import MANY, best_plans, check_ranges, correlated_noise, scales


@dataclass(frozen=True)
class PredictiveSamplingConfig:
    """Search with predictive sampling: noise around the best plan so far."""

    samples: int = 64
    """N, plans per refinement."""
    refinements: int = 1
    """Rounds of sampling per plan."""
    noise_scale: float = 0.8
    """Standard deviation of the sampled noise; controls lie in [-1, 1]."""
    finest: float | None = None
    """Noise of the last sample as a share of ``noise_scale``; the others lie between, evenly in ratio. Below 1 some
    plans are always near the present one, which holds small goals. None is the task's (0.1 in mazes of this package,
    1 in all others), and 1 in a search that is built by itself."""
    noise_correlation: float = 0.6
    """Correlation of the noise between neighbouring knots, in [0, 1)."""

    def least_samples(self, n_proposals: int) -> int:
        """The plan, proposals, and one with noise."""
        return 1 + n_proposals + 1

    def __post_init__(self) -> None:
        check_ranges(self, samples=(1, MANY), refinements=(1, MANY), noise_scale=(0, 100))
        check_ranges(self, noise_correlation=(0, 0.999))
        if self.finest is not None:
            check_ranges(self, finest=(1e-6, 1))


class PredictiveSampling:
    """Searches plans of K knots with U controls each; lower cost is better.

    Args:
        n_knots: K.
        n_controls: U, each in [-1, 1].
        config: how to search.
    """

    def __init__(self, n_knots: int, n_controls: int, config: PredictiveSamplingConfig | None = None) -> None:
        self.config = config or PredictiveSamplingConfig()
        self._shape = (n_knots, n_controls)
        self.reset()

    def reset(self) -> None:
        """Forget the plan: the next episode starts from zero."""
        self.plan = np.zeros(self._shape)
        self.effective_samples = 1.0

    def sample(self, rng: np.random.Generator, proposals: np.ndarray | None = None) -> np.ndarray:
        """Draw knots ``(N, K, U)``: the plan, proposals ``(P, K, U)``, and noise around the plan."""
        noise = correlated_noise(rng, (self.config.samples, *self._shape), self.config.noise_correlation)
        knots = self.plan + scales(self.config.samples, self.config.noise_scale, self.config.finest) * noise
        first = np.concatenate([self.plan[None], *([] if proposals is None else [proposals])])[: self.config.samples]
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
