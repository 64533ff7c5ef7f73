"""Cross-entropy method: a Gaussian over plans, refitted to the best samples.

Rubinstein and Kroese 2004, in numpy and nothing else: this file knows no simulator and no
network. Run it with ``python -m planners.cem --env fetch_wall``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.sampling import MANY, best_plans, check_elites, check_ranges


@dataclass(frozen=True)
class CEMConfig:
    """Search with the cross-entropy method: a Gaussian refitted to the best samples."""

    samples: int = 21
    """N, plans per refinement."""
    refinements: int = 3
    """Rounds of sampling per plan."""
    elites: int = 6
    """How many of the best plans the Gaussian is fitted to."""
    noise_scale: float = 0.8
    """Standard deviation before the first refinement; controls lie in [-1, 1]."""
    min_noise_scale: float = 0.05
    """The deviation does not shrink below this."""
    momentum: float = 0.1
    """Weight of the old mean and deviation in the new ones."""

    def least_samples(self, n_proposals: int) -> int:
        """The mean, proposals, and one with noise."""
        return 1 + n_proposals + 1

    def __post_init__(self) -> None:
        check_ranges(self, samples=(1, MANY), refinements=(1, MANY), elites=(1, MANY))
        check_ranges(self, noise_scale=(0, 100), min_noise_scale=(0, 100), momentum=(0, 1))
        check_elites(self.elites, self.samples)


class CEM:
    """Searches plans of K knots with U controls each; lower cost is better.

    Args:
        n_knots: K.
        n_controls: U, each in [-1, 1].
        config: how to search.
    """

    def __init__(self, n_knots: int, n_controls: int, config: CEMConfig | None = None) -> None:
        self.config = config or CEMConfig()
        self._shape = (n_knots, n_controls)
        self.reset()

    def reset(self) -> None:
        """Forget the plan: the next episode starts from zero."""
        self.mean = np.zeros(self._shape)
        self.deviation = np.full(self._shape, self.config.noise_scale)
        self.effective_samples = float(self.config.elites)

    @property
    def plan(self) -> np.ndarray:
        """The knots to execute, ``(K, U)``."""
        return self.mean

    def sample(self, rng: np.random.Generator, proposals: np.ndarray | None = None) -> np.ndarray:
        """Draw knots ``(N, K, U)``: the mean, proposals ``(P, K, U)``, and samples of the Gaussian."""
        knots = self.mean + self.deviation * rng.standard_normal((self.config.samples, *self._shape))
        first = np.concatenate([self.mean[None], *([] if proposals is None else [proposals])])[: self.config.samples]
        knots[: len(first)] = first
        return np.clip(knots, -1.0, 1.0)

    def update(self, knots: np.ndarray, costs: np.ndarray) -> None:
        """Fit the Gaussian to the elites of ``knots`` ``(N, K, U)``; no finite cost keeps it."""
        elites = knots[best_plans(costs, self.config.elites)]
        if len(elites):
            old = self.config.momentum
            self.mean = old * self.mean + (1.0 - old) * elites.mean(0)
            deviation = old * self.deviation + (1.0 - old) * elites.std(0)
            self.deviation = np.maximum(deviation, self.config.min_noise_scale)
            self.effective_samples = float(len(elites))

    def adopt(self, knots: np.ndarray) -> None:
        """Go on from this plan ``(K, U)``: it becomes the mean."""
        self.mean = knots

    def shift(self, shift: np.ndarray) -> None:
        """Warm start: move the mean on by one control step with a matrix ``(K, K)``; search wide again."""
        self.mean = shift @ self.mean
        self.deviation = np.full(self._shape, self.config.noise_scale)


if __name__ == "__main__":
    from planners.app.cli import main

    main("cem")
