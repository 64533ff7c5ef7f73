"""Cross-entropy method: a Gaussian over plans, refitted to the best samples.

Rubinstein and Kroese 2004, in numpy and nothing else: this file knows no simulator and no
network. Run it with ``python -m planners.cem --env fetch_wall``.
"""

from __future__ import annotations

import numpy as np

from planners.sampling import best_plans


class CEM:
    """Searches plans of K knots with U controls each; lower cost is better.

    Args:
        n_knots: K.
        n_controls: U, each in [-1, 1].
        n_samples: N, plans per refinement.
        n_elites: how many of the best plans the Gaussian is fitted to.
        noise_scale: standard deviation before the first refinement, in control units.
        min_noise_scale: the deviation does not shrink below this.
        momentum: weight of the old mean and deviation in the new ones.
    """

    def __init__(
        self,
        n_knots: int,
        n_controls: int,
        n_samples: int = 21,
        n_elites: int = 6,
        noise_scale: float = 0.8,
        min_noise_scale: float = 0.05,
        momentum: float = 0.1,
    ) -> None:
        self.n_samples, self.n_elites, self.momentum = n_samples, n_elites, momentum
        self.noise_scale, self.min_noise_scale = noise_scale, min_noise_scale
        self._shape = (n_knots, n_controls)
        self.reset()

    def reset(self) -> None:
        """Forget the plan: the next episode starts from zero."""
        self.mean = np.zeros(self._shape)
        self.deviation = np.full(self._shape, self.noise_scale)
        self.effective_samples = float(self.n_elites)

    @property
    def plan(self) -> np.ndarray:
        """The knots to execute, ``(K, U)``."""
        return self.mean

    def sample(self, rng: np.random.Generator, proposals: np.ndarray | None = None) -> np.ndarray:
        """Draw knots ``(N, K, U)``: the mean, proposals ``(P, K, U)``, and samples of the Gaussian."""
        knots = self.mean + self.deviation * rng.standard_normal((self.n_samples, *self._shape))
        first = np.concatenate([self.mean[None], *([] if proposals is None else [proposals])])[: self.n_samples]
        knots[: len(first)] = first
        return np.clip(knots, -1.0, 1.0)

    def update(self, knots: np.ndarray, costs: np.ndarray) -> None:
        """Fit the Gaussian to the elites of ``knots`` ``(N, K, U)``; no finite cost keeps it."""
        elites = knots[best_plans(costs, self.n_elites)]
        if len(elites):
            old = self.momentum
            self.mean = old * self.mean + (1.0 - old) * elites.mean(0)
            deviation = old * self.deviation + (1.0 - old) * elites.std(0)
            self.deviation = np.maximum(deviation, self.min_noise_scale)
            self.effective_samples = float(len(elites))

    def adopt(self, knots: np.ndarray) -> None:
        """Go on from this plan ``(K, U)``: it becomes the mean."""
        self.mean = knots

    def shift(self, shift: np.ndarray) -> None:
        """Warm start: move the mean on by one control step with a matrix ``(K, K)``; search wide again."""
        self.mean = shift @ self.mean
        self.deviation = np.full(self._shape, self.noise_scale)


if __name__ == "__main__":
    from planners.app.cli import main

    main("cem")
