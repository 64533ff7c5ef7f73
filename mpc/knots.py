"""Plans as a few knots: linear maps from knots to controls and from a plan to the shifted plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from napsp.errors import UserError
from napsp.settings import MANY, check_ranges

Interpolation = Literal["zero", "linear", "cubic"]


@dataclass(frozen=True)
class SplineConfig:
    """The knots of a plan: what the search varies."""

    knots: int | None = None
    """K, spline knots per plan; default one per control step."""
    interpolation: Interpolation = "linear"
    """How knots become controls."""

    def __post_init__(self) -> None:
        check_ranges(self, knots=(1, MANY))
        if self.knots is None and self.interpolation != "linear":
            raise UserError("--spline.interpolation needs --spline.knots: one knot per control step leaves no gaps")


def interpolation_matrix(n_knots: int, horizon: int, kind: Interpolation) -> np.ndarray:
    """Matrix ``(H, K)`` that turns K knots, spread over the horizon, into H controls.

    With ``n_knots == horizon`` it is the identity: one knot per control step.
    """
    return _evaluate(n_knots, horizon, kind, np.arange(horizon))


def shift_matrix(n_knots: int, horizon: int, kind: Interpolation) -> np.ndarray:
    """Matrix ``(K, K)`` that moves a plan on by one control step (the warm start).

    Held knots ("zero") that are more than a step apart cannot follow exactly: reading each one step later would
    leave all as they are, for ever. They become those nearest to the moved controls (least squares).
    """
    if kind == "zero":
        to_controls = interpolation_matrix(n_knots, horizon, kind)
        later = np.minimum(np.arange(horizon) + 1, horizon - 1)
        return np.linalg.pinv(to_controls) @ to_controls[later]
    return _evaluate(n_knots, horizon, kind, _knot_times(n_knots, horizon) + 1.0)


def _knot_times(n_knots: int, horizon: int) -> np.ndarray:
    return np.linspace(0.0, horizon - 1.0, n_knots) if n_knots > 1 else np.zeros(1)


def _evaluate(n_knots: int, horizon: int, kind: Interpolation, times: np.ndarray) -> np.ndarray:
    """Rows of interpolation weights for the given times; each row sums to one."""
    if not 1 <= n_knots <= horizon:
        raise ValueError(f"n_knots is {n_knots}; it must lie between 1 and the horizon {horizon}")
    if n_knots == 1:
        return np.ones((len(times), 1))
    knot_times, identity = _knot_times(n_knots, horizon), np.eye(n_knots)
    times = np.clip(times, 0.0, knot_times[-1])
    if kind == "cubic" and n_knots > 2:
        from scipy.interpolate import CubicSpline  # takes half a second to import, and is not the default

        return CubicSpline(knot_times, identity)(times)
    if kind == "zero":
        return identity[np.searchsorted(knot_times, times, side="right") - 1]
    return np.stack([np.interp(times, knot_times, weights) for weights in identity], axis=1)
