"""iCEM: the cross-entropy method with coloured noise and a memory for good plans.

Pinneri et al. 2020, "Sample-efficient cross-entropy method for real-time planning", in numpy and
nothing else: this file knows no simulator and no network. Run it with ``python -m planners.icem``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.sampling import MANY, best_plans, check_elites, check_ranges, coloured_noise


@dataclass(frozen=True)
class ICEMConfig:
    """Search with iCEM: the cross-entropy method with coloured noise and kept elites."""

    samples: int = 26
    """N, plans in the first refinement; later ones get fewer (decay)."""
    refinements: int = 3
    """Rounds of sampling per plan."""
    decay: float = 1.25
    """Factor between the samples of one refinement and the next."""
    elites: int = 6
    """How many of the best plans the Gaussian is fitted to."""
    kept: float = 0.3
    """Share of the elites that is tried again, in the next refinement and the next step."""
    noise_scale: float = 0.5
    """Standard deviation before the first refinement; controls lie in [-1, 1]."""
    noise_exponent: float = 3.0
    """Beta, how fast the noise's power falls with frequency; 0 is white noise."""
    momentum: float = 0.1
    """Weight of the old mean and deviation in the new ones."""

    def least_samples(self, n_proposals: int) -> int:
        """Kept elites, proposals (in the first refinement) and the mean (in the last), and one with noise."""
        others = n_proposals + 1 if self.refinements == 1 else max(n_proposals, 1)
        return math.ceil(self.kept * self.elites) + others + 1

    def __post_init__(self) -> None:
        check_ranges(self, samples=(1, MANY), refinements=(1, MANY), decay=(1, 1000), elites=(1, MANY), kept=(0, 1))
        check_ranges(self, noise_scale=(0, 100), noise_exponent=(0, 10), momentum=(0, 1))
        check_elites(self.elites, self.samples)


class ICEM:
    """Searches plans of K knots with U controls each; lower cost is better.

    Beside CEM: noise of falling power over frequency, fewer samples in every refinement, a share
    of the elites kept from refinement to refinement and (shifted) from step to step, the mean
    itself tried in the last refinement, and the best plan seen executed instead of the mean.

    Args:
        n_knots: K.
        n_controls: U, each in [-1, 1].
        config: how to search.
    """

    def __init__(self, n_knots: int, n_controls: int, config: ICEMConfig | None = None) -> None:
        self.config = config or ICEMConfig()
        self._shape = (n_knots, n_controls)
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next episode starts from zero."""
        self.mean = np.zeros(self._shape)
        self.effective_samples = float(self.config.elites)
        self._elites = np.empty((0, *self._shape))
        self._best, self._best_cost = self.mean, np.inf
        self._start_step()

    def _start_step(self) -> None:
        self.deviation = np.full(self._shape, self.config.noise_scale)
        self._refinement = 0

    @property
    def plan(self) -> np.ndarray:
        """The knots to execute, ``(K, U)``: the best plan of this step."""
        return self._best

    def sample(self, rng: np.random.Generator, proposals: np.ndarray | None = None) -> np.ndarray:
        """Draw knots ``(n, K, U)``, n <= N falling with the refinements: kept elites, proposals, noise.

        ``proposals`` ``(P, K, U)`` are tried in the first refinement only.
        """
        n = max(2 * self.config.elites, int(self.config.samples / self.config.decay**self._refinement))
        n = min(n, self.config.samples)
        noise = coloured_noise(rng, (n, *self._shape), self.config.noise_exponent)
        knots = self.mean + self.deviation * noise
        first = [self._elites[: int(np.ceil(self.config.kept * len(self._elites)))]]
        if self._refinement == 0 and proposals is not None:
            first.append(proposals)
        if self._refinement == self.config.refinements - 1:
            first.append(self.mean[None])
        special = np.concatenate(first)[:n]
        knots[: len(special)] = special
        return np.clip(knots, -1.0, 1.0)

    def update(self, knots: np.ndarray, costs: np.ndarray) -> None:
        """Fit the Gaussian to the elites of ``knots`` ``(n, K, U)``; no finite cost keeps it."""
        self._refinement += 1
        order = best_plans(costs, self.config.elites)
        if not len(order):
            return
        self._elites = knots[order]
        old = self.config.momentum
        self.mean = old * self.mean + (1.0 - old) * self._elites.mean(0)
        self.deviation = old * self.deviation + (1.0 - old) * self._elites.std(0)
        self.effective_samples = float(len(order))
        if costs[order[0]] < self._best_cost:
            self._best, self._best_cost = self._elites[0], float(costs[order[0]])

    def adopt(self, knots: np.ndarray) -> None:
        """Go on from this plan ``(K, U)``: it becomes the mean, the best and the first of the elites."""
        self.mean = self._best = knots
        self._elites = np.concatenate([knots[None], self._elites[: self.config.elites - 1]])

    def shift(self, shift: np.ndarray) -> None:
        """Warm start: move mean and elites on by one control step with a matrix ``(K, K)``."""
        self.mean, self._elites = shift @ self.mean, shift @ self._elites
        # Costs of the last step do not hold any more; until others are known its plan goes on.
        self._best, self._best_cost = shift @ self._best, np.inf
        self._start_step()


if __name__ == "__main__":
    from planners.app.cli import main

    main("icem")
