"""iCEM: the cross-entropy method with coloured noise and a memory for good plans.

Pinneri et al. 2020, "Sample-efficient cross-entropy method for real-time planning", in numpy and
nothing else: this file knows no simulator and no network. Run it with ``python -m planners.icem``.
"""

from __future__ import annotations

import numpy as np

from planners.sampling import best_plans, coloured_noise


class ICEM:
    """Searches plans of K knots with U controls each; lower cost is better.

    Beside CEM: noise of falling power over frequency, fewer samples in every refinement, a share
    of the elites kept from refinement to refinement and (shifted) from step to step, the mean
    itself tried in the last refinement, and the best plan seen executed instead of the mean.

    Args:
        n_knots: K.
        n_controls: U, each in [-1, 1].
        n_samples: N, plans in the first refinement.
        n_refinements: refinements per plan.
        decay: factor between the samples of one refinement and the next.
        n_elites: how many of the best plans the Gaussian is fitted to.
        kept: share of the elites that is tried again.
        noise_scale: standard deviation before the first refinement, in control units.
        noise_exponent: beta, how fast the noise's power falls with frequency.
        momentum: weight of the old mean and deviation in the new ones.
    """

    def __init__(
        self,
        n_knots: int,
        n_controls: int,
        n_samples: int = 26,
        n_refinements: int = 3,
        decay: float = 1.25,
        n_elites: int = 6,
        kept: float = 0.3,
        noise_scale: float = 0.5,
        noise_exponent: float = 3.0,
        momentum: float = 0.1,
    ) -> None:
        self.n_samples, self.n_refinements, self.decay = n_samples, n_refinements, decay
        self.n_elites, self.kept, self.momentum = n_elites, kept, momentum
        self.noise_scale, self.noise_exponent = noise_scale, noise_exponent
        self._shape = (n_knots, n_controls)
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next episode starts from zero."""
        self.mean = np.zeros(self._shape)
        self.effective_samples = float(self.n_elites)
        self._elites = np.empty((0, *self._shape))
        self._best, self._best_cost = self.mean, np.inf
        self._start_step()

    def _start_step(self) -> None:
        self.deviation = np.full(self._shape, self.noise_scale)
        self._refinement = 0

    @property
    def plan(self) -> np.ndarray:
        """The knots to execute, ``(K, U)``: the best plan of this step."""
        return self._best

    def sample(self, rng: np.random.Generator, proposals: np.ndarray | None = None) -> np.ndarray:
        """Draw knots ``(n, K, U)``, n <= N falling with the refinements: kept elites, proposals, noise.

        ``proposals`` ``(P, K, U)`` are tried in the first refinement only.
        """
        n = max(2 * self.n_elites, int(self.n_samples / self.decay**self._refinement))
        n = min(n, self.n_samples)
        noise = coloured_noise(rng, (n, *self._shape), self.noise_exponent)
        knots = self.mean + self.deviation * noise
        first = [self._elites[: int(np.ceil(self.kept * len(self._elites)))]]
        if self._refinement == 0 and proposals is not None:
            first.append(proposals)
        if self._refinement == self.n_refinements - 1:
            first.append(self.mean[None])
        special = np.concatenate(first)[:n]
        knots[: len(special)] = special
        return np.clip(knots, -1.0, 1.0)

    def update(self, knots: np.ndarray, costs: np.ndarray) -> None:
        """Fit the Gaussian to the elites of ``knots`` ``(n, K, U)``; no finite cost keeps it."""
        self._refinement += 1
        order = best_plans(costs, self.n_elites)
        if not len(order):
            return
        self._elites = knots[order]
        old = self.momentum
        self.mean = old * self.mean + (1.0 - old) * self._elites.mean(0)
        self.deviation = old * self.deviation + (1.0 - old) * self._elites.std(0)
        self.effective_samples = float(len(order))
        if costs[order[0]] < self._best_cost:
            self._best, self._best_cost = self._elites[0], float(costs[order[0]])

    def adopt(self, knots: np.ndarray) -> None:
        """Go on from this plan ``(K, U)``: it becomes the mean, the best and the first of the elites."""
        self.mean = self._best = knots
        self._elites = np.concatenate([knots[None], self._elites[: self.n_elites - 1]])

    def shift(self, shift: np.ndarray) -> None:
        """Warm start: move mean and elites on by one control step with a matrix ``(K, K)``."""
        self.mean, self._elites = shift @ self.mean, shift @ self._elites
        # Costs of the last step do not hold any more; until others are known its plan goes on.
        self._best, self._best_cost = shift @ self._best, np.inf
        self._start_step()


if __name__ == "__main__":
    from planners.app.cli import main

    main("icem")
