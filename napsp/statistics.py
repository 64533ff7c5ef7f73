"""Intervals that go with every mean."""

from __future__ import annotations

from scipy.stats import binomtest


def wilson_interval(successes: int, n: int) -> tuple[float, float]:
    """95 % Wilson score interval of a success rate."""
    interval = binomtest(successes, n).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def describe(rate: float, interval: tuple[float, float]) -> str:
    """A rate and its interval as text."""
    return f"{rate:.2f} [{interval[0]:.2f}, {interval[1]:.2f}]"
