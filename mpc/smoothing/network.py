"""Networks with exact first and second derivatives, written once for numpy and for CasADi.

Left to CasADi's own differentiation, the Hessian of such a network takes a hundred times as long, because it is built
from matrix-vector products.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np
from torch import Tensor, nn

from napsp.networks import InputScaling
from napsp.scaling import Scaling


@dataclass(frozen=True)
class Library:
    """The few operations the formulas need; a vector is a column ``(..., n, 1)``."""

    part: Callable[[Any, int, int], Any]
    """Entries ``[start, stop)`` of a column, or rows of a matrix."""
    product: Callable[[Any, Any], Any]
    rows: Callable[[Any, Any], Any]
    """Scale the rows of a matrix ``(..., h, n)`` by a column ``(..., h, 1)``."""
    transpose: Callable[[Any], Any]
    stack: Callable[..., Any]
    tanh: Callable[[Any], Any]
    positive: Callable[[Any], Any]
    """max(x, 0)."""
    log1p_exp_minus: Callable[[Any], Any]
    """log(1 + exp(-|x|)), which cannot overflow."""
    clip: Callable[[Any, float], Any]
    inside: Callable[[Any, float], Any]
    """One where ``|x| <= limit``, else zero."""


NUMPY = Library(
    part=lambda x, start, stop: x[..., start:stop, :],
    product=np.matmul,
    rows=np.multiply,
    transpose=lambda a: np.swapaxes(a, -1, -2),
    stack=lambda *parts: np.concatenate(parts, axis=-2),
    tanh=np.tanh,
    positive=lambda x: np.maximum(x, 0.0),
    log1p_exp_minus=lambda x: np.log1p(np.exp(-np.abs(x))),
    clip=lambda x, limit: np.clip(x, -limit, limit),
    inside=lambda x, limit: (np.abs(x) <= limit).astype(float),
)
CASADI = Library(
    part=lambda x, start, stop: x[start:stop, :],
    product=lambda a, b: casadi.mtimes(a, b, "classic"),  # BLAS; fifty times faster for these sizes
    rows=lambda column, matrix: casadi.repmat(column, 1, matrix.shape[1]) * matrix,
    transpose=lambda a: a.T,
    stack=casadi.vertcat,
    tanh=casadi.tanh,
    positive=lambda x: casadi.fmax(x, 0.0),
    log1p_exp_minus=lambda x: casadi.log1p(casadi.exp(-casadi.fabs(x))),
    clip=lambda x, limit: casadi.fmin(casadi.fmax(x, -limit), limit),
    inside=lambda x, limit: casadi.fabs(x) <= limit,
)


class Network:
    """Linear layers with SiLU between them, as float64 weights."""

    def __init__(self, net: nn.Sequential, n_outputs: int) -> None:
        layers = [layer for layer in net if isinstance(layer, nn.Linear)]
        self.layers = [(float64(layer.weight), float64(layer.bias)[:, None]) for layer in layers]
        weights, bias = self.layers[-1]
        self.layers[-1] = weights[:n_outputs], bias[:n_outputs]

    def forward(self, lib: Library, values: Any, slopes: Any) -> tuple[Any, Any, list[Any]]:
        """Outputs, their Jacobian, and what :meth:`curvature` needs.

        ``values`` ``(..., n, 1)`` are the inputs, ``slopes`` ``(..., n, m)`` their Jacobian.
        """
        tape = []
        for weights, bias in self.layers[:-1]:
            z = lib.product(weights, values) + bias
            s = 0.5 * (1.0 + lib.tanh(0.5 * z))  # the logistic function, without exp's overflow
            if slopes is not None:
                slope, bend = s * (1.0 + z * (1.0 - s)), s * (1.0 - s) * (2.0 + z * (1.0 - 2.0 * s))
                slopes = lib.product(weights, slopes)
                tape.append((weights, slope, bend, slopes))
                slopes = lib.rows(slope, slopes)
            values = z * s
        weights, bias = self.layers[-1]
        return lib.product(weights, values) + bias, None if slopes is None else lib.product(weights, slopes), tape

    def curvature(self, lib: Library, tape: list[Any], multiplier: Any) -> tuple[Any, Any]:
        """Second derivatives of ``multiplier' outputs``: (multiplier of the inputs, Hessian).

        With z_l the inputs of the nonlinearity sigma of layer l, J_l their Jacobian and lambda_l the multiplier of
        its outputs, the Hessian is the sum over l of J_l' diag(lambda_l sigma''(z_l)) J_l.
        """
        multiplier, hessian = lib.product(self.layers[-1][0].T, multiplier), 0.0
        for weights, slope, bend, slopes in reversed(tape):
            hessian = hessian + lib.product(lib.transpose(slopes), lib.rows(multiplier * bend, slopes))
            multiplier = lib.product(weights.T, slope * multiplier)
        return multiplier, hessian


class InputMap:
    """A network's input scaling, clipped at +-LIMIT as in the network, and its slope."""

    def __init__(self, scaling: InputScaling) -> None:
        self._goal = float64(scaling.goal_mean)[:, None], float64(scaling.goal_scale)[:, None]
        self._observation = float64(scaling.observation_mean)[:, None], float64(scaling.observation_scale)[:, None]
        self.n_observation, self.n_goal = len(self._observation[0]), len(self._goal[0])

    def __call__(
        self, lib: Library, observation: Any, goal: Any, d_observation: Any = 1.0, d_goal: Any = 1.0
    ) -> tuple[Any, Any, Any, Any]:
        """Scaled observation and goal, then their Jacobians."""
        values, slopes = [], []
        for x, slope, (mean, scale) in ((observation, d_observation, self._observation), (goal, d_goal, self._goal)):
            z = (x - mean) / scale
            values.append(lib.clip(z, Scaling.LIMIT))
            slopes.append(lib.rows(lib.inside(z, Scaling.LIMIT) / scale, slope))
        return values[0], values[1], slopes[0], slopes[1]


def float64(tensor: Tensor) -> np.ndarray:
    """A tensor's numbers in double precision."""
    return tensor.detach().double().numpy()
