"""Model predictive path integral control: the exponentially weighted mean of noisy plans.

Williams et al. 2017, in numpy and nothing else: this file knows no simulator and no network.
Run it with ``python -m planners.mppi --env fetch_wall``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.sampling import MANY, check_ranges, correlated_noise, scales


@dataclass(frozen=True)
class MPPIConfig:
    """Search with MPPI: the exponentially weighted mean of noisy plans."""

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
    temperature: float = 0.2
    """MPPI's lambda, in standard deviations of the sampled costs: the same value serves costs of any size."""

    def least_samples(self, n_proposals: int) -> int:
        """The mean, the best plan, proposals, and one with noise."""
        return 2 + n_proposals + 1

    def __post_init__(self) -> None:
        check_ranges(self, samples=(1, MANY), refinements=(1, MANY), noise_scale=(0, 100))
        check_ranges(self, noise_correlation=(0, 0.999), temperature=(1e-9, 1e9))
        if self.finest is not None:
            check_ranges(self, finest=(1e-6, 1))


class MPPI:
    """Searches plans of K knots with U controls each; lower cost is better.

    A plan is refined by calling :meth:`sample`, rolling the knots out, and handing their
    costs to :meth:`update`. Between control steps :meth:`shift` moves the plan on in time.

    Args:
        n_knots: K.
        n_controls: U, each in [-1, 1].
        config: how to search.
    """

    def __init__(self, n_knots: int, n_controls: int, config: MPPIConfig | None = None) -> None:
        self.config = config or MPPIConfig()
        self._shape = (n_knots, n_controls)
        self.reset()

    def reset(self) -> None:
        """Forget the plan: the next episode starts from zero."""
        self.mean = np.zeros(self._shape)
        self.best: np.ndarray | None = None
        self.effective_samples = float(self.config.samples)

    @property
    def plan(self) -> np.ndarray:
        """The knots to execute, ``(K, U)``."""
        return self.mean

    def sample(self, rng: np.random.Generator, proposals: np.ndarray | None = None) -> np.ndarray:
        """Draw knots ``(N, K, U)``: the mean, the last best plan, proposals, and noise around the mean.

        ``proposals`` ``(P, K, U)`` replace noisy plans; they come from a policy, say.
        """
        noise = correlated_noise(rng, (self.config.samples, *self._shape), self.config.noise_correlation)
        knots = self.mean + scales(self.config.samples, self.config.noise_scale, self.config.finest) * noise
        kept = [self.mean[None]]
        if self.best is not None:
            kept.append(self.best[None])
        if proposals is not None:
            kept.append(proposals)
        first = np.concatenate(kept)[: self.config.samples]
        knots[: len(first)] = first
        return np.clip(knots, -1.0, 1.0)

    def update(self, knots: np.ndarray, costs: np.ndarray) -> None:
        """Move the mean to the weighted mean of ``knots`` ``(N, K, U)``.

        A cost that is infinite or NaN has weight zero; if none is finite the plan stays.
        """
        if not np.isfinite(costs).any():
            return
        weights = softmin(costs, self.config.temperature)
        counted = weights > 0.0  # NaN times zero is NaN
        self.mean = np.tensordot(weights[counted], knots[counted], axes=1)
        self.best = knots[np.nanargmin(costs)].copy()
        self.effective_samples = float(1.0 / np.square(weights).sum())

    def adopt(self, knots: np.ndarray) -> None:
        """Go on from this plan ``(K, U)``: it becomes the mean and the best."""
        self.mean, self.best = knots, knots

    def shift(self, shift: np.ndarray) -> None:
        """Warm start: move the plan on by one control step with a shift matrix ``(K, K)``."""
        self.mean = shift @ self.mean
        if self.best is not None:
            self.best = shift @ self.best


def softmin(costs: np.ndarray, temperature: float) -> np.ndarray:
    """Weights ``(N,)`` proportional to exp(-cost / (temperature * std of the finite costs)).

    They sum to one and do not change when a constant is added to the costs or when the
    costs are scaled. Costs without spread get equal weights.
    """
    finite = np.isfinite(costs)
    spread = costs[finite].std()
    excess = np.where(finite, costs - costs[finite].min(), np.inf)
    scale = temperature * spread
    weights = np.exp(-excess / scale) if scale > 1e-12 else (excess <= 1e-12).astype(float)
    return weights / weights.sum()


if __name__ == "__main__":
    from planners.app.cli import main

    main("mppi")
