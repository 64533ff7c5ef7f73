"""The trained d(s, a, g) with exact first and second derivatives, in numpy and in CasADi.

The formulas are written once and run on either library. Left to CasADi's own differentiation, the Hessian of such a
network takes a hundred times as long, because it is built from matrix-vector products.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np
from torch import Tensor, nn

from mpc.cost import ActionOf
from napsp.checkpoint import Model
from napsp.networks import InputScaling
from napsp.scaling import Scaling


@dataclass(frozen=True)
class Library:
    """The few operations the formulas need; a vector is a column ``(..., n, 1)``."""

    product: Callable[[Any, Any], Any]
    rows: Callable[[Any, Any], Any]
    """Scale the rows of a matrix ``(..., h, n)`` by a column ``(..., h, 1)``."""
    transpose: Callable[[Any], Any]
    stack: Callable[..., Any]
    tanh: Callable[[Any], Any]
    clip: Callable[[Any, float], Any]
    inside: Callable[[Any, float], Any]
    """One where ``|x| <= limit``, else zero."""


def _casadi_product(a: Any, b: Any) -> Any:
    try:
        return casadi.mtimes(a, b, "classic")  # BLAS; fifty times faster for these sizes
    except (NotImplementedError, TypeError):  # CasADi before 3.8 has no such argument
        return casadi.mtimes(a, b)


NUMPY = Library(
    product=np.matmul,
    rows=np.multiply,
    transpose=lambda a: np.swapaxes(a, -1, -2),
    stack=lambda *parts: np.concatenate(parts, axis=-2),
    tanh=np.tanh,
    clip=lambda x, limit: np.clip(x, -limit, limit),
    inside=lambda x, limit: (np.abs(x) <= limit).astype(float),
)
CASADI = Library(
    product=_casadi_product,
    rows=lambda column, matrix: casadi.repmat(column, 1, matrix.shape[1]) * matrix,
    transpose=lambda a: a.T,
    stack=casadi.vertcat,
    tanh=casadi.tanh,
    clip=lambda x, limit: casadi.fmin(casadi.fmax(x, -limit), limit),
    inside=lambda x, limit: casadi.fabs(x) <= limit,
)


class Network:
    """Linear layers with SiLU between them, as float64 weights."""

    def __init__(self, net: nn.Sequential, n_outputs: int) -> None:
        layers = [layer for layer in net if isinstance(layer, nn.Linear)]
        self.layers = [(_float64(layer.weight), _float64(layer.bias)[:, None]) for layer in layers]
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


class SmoothDistance:
    """d(s, a, g) in steps as a function of one vector x.

    ``action_of="plan"``: x = (s, a, g). ``"policy"``: x = (s, g), and the action is the policy's, a = pi(s, g).

    It is the network's raw prediction. ``DistanceNetwork.steps`` also clips it to [0, T], which would leave no slope
    far from the goal; between 0 and T the two are equal. Inputs beyond ``Scaling.LIMIT`` deviations are clipped as in
    the network: d is constant there and its derivatives are zero.
    """

    def __init__(self, model: Model, action_of: ActionOf) -> None:
        if model.distance is None:
            raise ValueError("the model holds no distance (it was trained with --method sparse)")
        if model.distance.output not in {"linear", "softplus"}:
            raise ValueError(f"unknown output {model.distance.output!r} of the distance; use linear or softplus")
        self.action_of = action_of
        self.horizon, self._softplus = float(model.distance.horizon), model.distance.output == "softplus"
        self._distance, self._policy = Network(model.distance.net, 1), Network(model.policy.net, model.policy.n_actions)
        self._scaling, self._policy_scaling = _Scaling(model.distance.scaling), _Scaling(model.policy.scaling)
        self.n_observation, self.n_goal = self._scaling.n_observation, self._scaling.n_goal
        self.n_action = model.policy.n_actions
        self.n_inputs = self.n_observation + self.n_goal + (self.n_action if action_of == "plan" else 0)

    def values(self, points: np.ndarray) -> np.ndarray:
        """Steps ``(B,)`` at rows x ``(B, n)``, without derivatives: a fraction of the time."""
        n_s, n_g, rows = self.n_observation, self.n_goal, points[..., None]
        observation, goal = rows[:, :n_s], rows[:, -n_g:]
        if self.action_of == "plan":
            action = rows[:, n_s:-n_g]
        else:
            scaled = np.concatenate(self._policy_scaling(NUMPY, observation, goal)[:2], axis=1)
            action = np.tanh(self._policy.forward(NUMPY, scaled, None)[0])
        s, g = self._scaling(NUMPY, observation, goal)[:2]
        raw = self._distance.forward(NUMPY, np.concatenate([s, action, g], axis=1), None)[0]
        return self._output(NUMPY, raw)[0][:, 0, 0]

    def evaluate(self, points: np.ndarray, order: int = 2) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Value ``(B,)``, gradient ``(B, n)`` and, for order 2, Hessian ``(B, n, n)`` at rows x ``(B, n)``."""
        value, gradient, hessian = self.formulas(NUMPY, points[..., None], np.eye(self.n_inputs), order)
        return value[:, 0, 0], gradient[:, 0], hessian

    def formulas(self, lib: Library, x: Any, identity: Any, order: int) -> tuple[Any, Any, Any]:
        """Value ``(..., 1, 1)``, gradient ``(..., 1, n)`` and Hessian ``(..., n, n)`` (None below order 2)."""
        n_s, n_g = self.n_observation, self.n_goal
        n = self.n_inputs
        observation, goal = (
            x[..., :n_s, :] if lib is NUMPY else x[:n_s],
            x[..., n - n_g :, :] if lib is NUMPY else x[-n_g:],
        )
        d_observation, d_goal = identity[:n_s, :], identity[n - n_g :, :]
        outputs, output_slopes, policy_tape = None, None, []
        if self.action_of == "plan":
            action = x[..., n_s : n - n_g, :] if lib is NUMPY else x[n_s:-n_g]
            d_action = identity[n_s : n - n_g, :]
        else:
            parts = self._policy_scaling(lib, observation, goal, d_observation, d_goal)
            outputs, output_slopes, policy_tape = self._policy.forward(
                lib, lib.stack(parts[0], parts[1]), lib.stack(parts[2], parts[3])
            )
            action = lib.tanh(outputs)
            d_action = lib.rows(1.0 - action * action, output_slopes)
        s, g, d_s, d_g = self._scaling(lib, observation, goal, d_observation, d_goal)
        if lib is NUMPY and d_action.ndim < d_s.ndim:
            d_action = np.broadcast_to(d_action, (*d_s.shape[:-2], *d_action.shape))
        raw, slopes, tape = self._distance.forward(lib, lib.stack(s, action, g), lib.stack(d_s, d_action, d_g))
        value, first, second = self._output(lib, raw)
        if order < 2:
            return value, first * slopes, None
        multiplier, hessian = self._distance.curvature(lib, tape, first)
        hessian = hessian + second * lib.product(lib.transpose(slopes), slopes)
        if self.action_of == "policy":
            of_action = (
                multiplier[..., n_s : n_s + self.n_action, :] if lib is NUMPY else multiplier[n_s : n_s + self.n_action]
            )
            slope = 1.0 - action * action
            bent = lib.rows(-2.0 * action * slope * of_action, output_slopes)
            hessian = hessian + lib.product(lib.transpose(output_slopes), bent)
            hessian = hessian + self._policy.curvature(lib, policy_tape, slope * of_action)[1]
        return value, first * slopes, hessian

    def _output(self, lib: Library, raw: Any) -> tuple[Any, Any, Any]:
        """Steps and their first two derivatives with respect to the network's last output."""
        if not self._softplus:
            return self.horizon * raw, self.horizon + 0.0 * raw, 0.0 * raw
        log1p, exp, fabs = (np.log1p, np.exp, np.abs) if lib is NUMPY else (casadi.log1p, casadi.exp, casadi.fabs)
        sigma = 0.5 * (1.0 + lib.tanh(0.5 * raw))
        softplus = 0.5 * (raw + fabs(raw)) + log1p(exp(-fabs(raw)))
        return self.horizon * softplus, self.horizon * sigma, self.horizon * sigma * (1.0 - sigma)

    def function(self) -> casadi.Function:
        """The CasADi function x ``(n,)`` -> y ``()``, with these derivatives in place of CasADi's own."""
        n, identity = self.n_inputs, np.eye(self.n_inputs)
        x, y, j = casadi.MX.sym("x", n), casadi.MX.sym("y"), casadi.MX.sym("j", 1, n)
        # CasADi silently prefers its own derivatives unless both directions are switched off.
        ours = {"never_inline": True, "enable_forward": False, "enable_reverse": False}
        value, gradient, hessian = self.formulas(CASADI, x, identity, 2)
        second = casadi.Function(
            "jac_jac_d", [x, y, j], [hessian, casadi.MX(n, 1)], ["x", "out_y", "out_jac_y_x"],
            ["jac_jac_y_x_x", "jac_jac_y_x_out_y"],
        )  # fmt: skip
        first = casadi.Function(
            "jac_d", [x, y], [gradient], ["x", "out_y"], ["jac_y_x"], {**ours, "custom_jacobian": second}
        )
        return casadi.Function("d", [x], [value], ["x"], ["y"], {**ours, "custom_jacobian": first})


class _Scaling:
    """A network's input scaling and its slope."""

    def __init__(self, scaling: InputScaling) -> None:
        self._goal = _float64(scaling.goal_mean)[:, None], _float64(scaling.goal_scale)[:, None]
        self._observation = _float64(scaling.observation_mean)[:, None], _float64(scaling.observation_scale)[:, None]
        self.n_observation, self.n_goal = len(self._observation[0]), len(self._goal[0])

    def __call__(
        self, lib: Library, observation: Any, goal: Any, d_observation: Any = 1.0, d_goal: Any = 1.0
    ) -> tuple[Any, ...]:
        """Scaled observation and goal, then their Jacobians."""
        values, slopes = [], []
        for x, slope, (mean, scale) in ((observation, d_observation, self._observation), (goal, d_goal, self._goal)):
            z = (x - mean) / scale
            values.append(lib.clip(z, Scaling.LIMIT))
            slopes.append(lib.rows(lib.inside(z, Scaling.LIMIT) / scale, slope))
        return (*values, *slopes)


def _float64(tensor: Tensor) -> np.ndarray:
    return tensor.detach().double().numpy()
