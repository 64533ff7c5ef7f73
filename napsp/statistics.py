"""Intervals that go with every mean."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import binomtest, bootstrap, trim_mean


def wilson_interval(successes: int, n: int) -> tuple[float, float]:
    """95 % Wilson score interval of a success rate."""
    interval = binomtest(successes, n).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def interquartile_mean(values: Sequence[float]) -> tuple[float, tuple[float, float] | None]:
    """Mean of the middle half, and its 95 % percentile-bootstrap interval over seeds.

    With fewer than three values there is no interval: None.
    """
    data = np.asarray(values, float)
    mean = float(trim_mean(data, 0.25))
    if len(data) < 3:
        return mean, None

    def resampled(sample: np.ndarray, axis: int) -> np.ndarray:
        return trim_mean(sample, 0.25, axis=axis)

    interval = bootstrap(
        (data,), resampled, method="percentile", n_resamples=5000, rng=np.random.default_rng(0)
    ).confidence_interval
    return mean, (float(interval.low), float(interval.high))


def paired_difference(values: Sequence[float], reference: Sequence[float]) -> tuple[float, tuple[float, float]]:
    """Mean of ``values - reference`` pair by pair, and its 95 % percentile-bootstrap interval over the pairs."""
    differences = np.asarray(values, float) - np.asarray(reference, float)
    interval = bootstrap(
        (differences,), np.mean, method="percentile", n_resamples=5000, rng=np.random.default_rng(0)
    ).confidence_interval
    return float(differences.mean()), (float(interval.low), float(interval.high))


def describe(rate: float, interval: tuple[float, float] | None) -> str:
    """A rate and its interval as text."""
    return f"{rate:.2f}" if interval is None else f"{rate:.2f} [{interval[0]:.2f}, {interval[1]:.2f}]"
