"""What the search algorithms share: bounds of options, time-correlated noise, choosing the best plans. Numpy only."""

from __future__ import annotations

from typing import Any

import numpy as np

MANY = 10**6


def check_ranges(config: Any, **ranges: tuple[float, float]) -> None:
    """Check that fields of a configuration lie within inclusive bounds.

    Raises:
        ValueError: one does not; NaN never does.
    """
    for name, (low, high) in ranges.items():
        value = getattr(config, name)
        if not low <= value <= high:  # false for NaN as well
            raise ValueError(f"{name} is {value}; it must lie between {low:g} and {high:g}")


def check_elites(elites: int, samples: int) -> None:
    """Check that there are as many samples as elites are chosen from them.

    Raises:
        ValueError: there are not.
    """
    if elites > samples:
        raise ValueError(f"elites is {elites}, which exceeds the {samples} samples; use fewer elites or more samples")


def correlated_noise(rng: np.random.Generator, shape: tuple[int, int, int], correlation: float) -> np.ndarray:
    """Unit-variance Gaussian noise ``(N, K, U)`` with AR(1) correlation along K."""
    noise = rng.standard_normal(shape)
    fresh = np.sqrt(1.0 - correlation**2)
    for k in range(1, shape[1]):
        noise[:, k] = correlation * noise[:, k - 1] + fresh * noise[:, k]
    return noise


def scales(n: int, largest: float, finest: float | None) -> np.ndarray:
    """Standard deviations ``(N, 1, 1)`` of N samples: from ``largest`` to the share ``finest`` of it, evenly in ratio.

    None is all of one size. Where goals are small a plan holds one only if some samples are near the present plan:
    with noise of one size none stays at the goal for a whole horizon.
    """
    return (largest * (1.0 if finest is None else finest) ** np.linspace(0.0, 1.0, n))[:, None, None]


def coloured_noise(rng: np.random.Generator, shape: tuple[int, int, int], exponent: float) -> np.ndarray:
    """Unit-variance Gaussian noise ``(N, K, U)`` whose power falls as 1 / frequency^exponent along K.

    Timmer and Koenig 1995: white noise in the frequency domain, scaled and transformed back.
    Exponent 0 is white; 2 to 3 gives the smooth, far-reaching motions that arms need (iCEM).
    The lowest frequency of K samples, 1 / K, also stands for the mean.
    """
    n, n_knots, n_controls = shape
    if n_knots == 1:
        return rng.standard_normal(shape)
    frequencies = np.fft.rfftfreq(n_knots)
    frequencies[0] = 1.0 / n_knots
    amplitudes = frequencies ** (-exponent / 2.0)
    size = (n, n_controls, len(amplitudes))
    spectrum = amplitudes * (rng.standard_normal(size) + 1j * rng.standard_normal(size))
    # The mean, and for even K the highest frequency, have no imaginary part.
    power = 2.0 * amplitudes**2
    for real in (0, *((-1,) if n_knots % 2 == 0 else ())):
        spectrum[..., real] = np.sqrt(2.0) * spectrum[..., real].real
    power[0] /= 2.0
    if n_knots % 2 == 0:
        power[-1] /= 2.0
    deviation = np.sqrt(2.0 * power.sum()) / n_knots
    return np.fft.irfft(spectrum, n_knots).transpose(0, 2, 1) / deviation


def best_plans(costs: np.ndarray, n: int) -> np.ndarray:
    """Indices of the ``n`` lowest finite costs, best first; fewer if fewer are finite."""
    order = np.argsort(np.where(np.isfinite(costs), costs, np.inf), kind="stable")
    return order[: min(n, int(np.isfinite(costs).sum()))]
