"""Intervals that go with every mean."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist

import numpy as np


def wilson_interval(successes: int, n: int) -> tuple[float, float]:
    """95 % Wilson score interval of a success rate.

    ``scipy.stats`` has it too, but takes as long to import as MuJoCo, Gymnasium and CasADi together, and every command
    shows such an interval. The bootstraps below, which only benchmarks need, import it when they are called.
    """
    z = NormalDist().inv_cdf(0.975)
    middle = (successes + z**2 / 2) / (n + z**2)
    half = z / (n + z**2) * (successes * (n - successes) / n + z**2 / 4) ** 0.5
    return 0.0 if successes == 0 else middle - half, 1.0 if successes == n else middle + half


def interquartile_mean(values: Sequence[float]) -> tuple[float, tuple[float, float] | None]:
    """Mean of the middle half, and its 95 % percentile-bootstrap interval over seeds.

    With fewer than three values there is no interval: None.
    """
    from scipy.stats import bootstrap, trim_mean

    data = np.asarray(values, float)
    mean = float(trim_mean(data, 0.25))
    if len(data) < 3:
        return mean, None
    if (data == data[0]).all():
        return mean, (mean, mean)  # as every resample has it

    def resampled(sample: np.ndarray, axis: int) -> np.ndarray:
        return trim_mean(sample, 0.25, axis=axis)

    interval = bootstrap(
        (data,), resampled, method="percentile", n_resamples=5000, rng=np.random.default_rng(0)
    ).confidence_interval
    return mean, (float(interval.low), float(interval.high))


def paired_difference(first: Sequence[float], second: Sequence[float]) -> tuple[float, tuple[float, float]]:
    """Mean of ``first - second`` over pairs, and its 95 % percentile-bootstrap interval."""
    from scipy.stats import bootstrap

    differences = np.asarray(first, float) - np.asarray(second, float)
    if (differences == differences[0]).all():
        return float(differences[0]), (float(differences[0]), float(differences[0]))
    interval = bootstrap(
        (differences,), np.mean, method="percentile", n_resamples=5000, rng=np.random.default_rng(0)
    ).confidence_interval
    return float(differences.mean()), (float(interval.low), float(interval.high))


def paired_proportions(first: Sequence[float], second: Sequence[float]) -> tuple[float, tuple[float, float]]:
    """Difference of two success rates on the same episodes, and its 95 % interval.

    Square-and-add Wilson interval for paired data (Newcombe 1998, Statistics in Medicine 17, method 10):
    unlike a bootstrap it does not shrink to a point where both agree in every episode.

    Args:
        first: successes, 0 or 1.
        second: those of the other, in the same episodes.
    """
    a, b = np.asarray(first, bool), np.asarray(second, bool)
    n, p, q = len(a), float(a.mean()), float(b.mean())
    (p_low, p_high), (q_low, q_high) = wilson_interval(int(a.sum()), n), wilson_interval(int(b.sum()), n)
    both, only_a, only_b, none = ((a & b).sum(), (a & ~b).sum(), (~a & b).sum(), (~a & ~b).sum())
    excess = float(both * none - only_a * only_b)
    if excess > 0:
        excess = max(excess - n / 2, 0.0)  # continuity correction
    spread = float(a.sum() * (~a).sum() * b.sum() * (~b).sum()) ** 0.5
    phi = excess / spread if spread else 0.0

    def width(down: float, up: float) -> float:
        return float(np.sqrt(max(down**2 - 2.0 * phi * down * up + up**2, 0.0)))

    difference = p - q
    return difference, (difference - width(p - p_low, q_high - q), difference + width(p_high - p, q - q_low))


def describe(rate: float, interval: tuple[float, float] | None, digits: int = 2) -> str:
    """A rate and its interval as text."""
    low, high = (f"{end:.{digits}f}" for end in interval) if interval else ("", "")
    return f"{rate:.{digits}f}" + (f" [{low}, {high}]" if interval else "")
