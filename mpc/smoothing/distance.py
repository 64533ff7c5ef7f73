"""The trained d(s, a, g), exact derivatives included, for numpy and as a CasADi function."""

from __future__ import annotations

from typing import Any

import casadi
import numpy as np

from mpc.reading import ActionOf
from mpc.smoothing.network import CASADI, NUMPY, InputMap, Library, Network
from napsp.storage.checkpoint import Model


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
        heads = model.distance.plain()
        if not heads:
            raise ValueError(
                "the distance is more than plain networks (--distance.head mlp, no layer norm), so the smoothing layer "
                "cannot write out its derivatives"
            )
        self.action_of, self.episode_length = action_of, float(model.distance.episode_length)
        self._steps = model.distance.steps_per_output / len(heads)  # d is the members' mean
        self._softplus = heads[0].output == "softplus"
        self._members = [Network(head.net, 1) for head in heads]
        self._policy = Network(model.policy.net, model.policy.n_actions)
        self._scaling, self._policy_scaling = InputMap(model.distance.scaling), InputMap(model.policy.scaling)
        self.n_observation, self.n_goal = self._scaling.n_observation, self._scaling.n_goal
        self.n_action = model.policy.n_actions
        self.n_inputs = self.n_observation + self.n_goal + (self.n_action if action_of == "plan" else 0)

    def values(self, points: np.ndarray) -> np.ndarray:
        """Steps ``(B,)`` at rows x ``(B, n)``, without derivatives: a fraction of the time."""
        s, a, g = self._split(NUMPY, points[..., None])
        if self.action_of == "policy":
            scaled = np.concatenate(self._policy_scaling(NUMPY, s, g)[:2], axis=1)
            a = np.tanh(self._policy.forward(NUMPY, scaled, None)[0])
        s, g = self._scaling(NUMPY, s, g)[:2]
        inputs = np.concatenate([s, a, g], axis=1)
        outputs = [self._output(NUMPY, member.forward(NUMPY, inputs, None)[0])[0] for member in self._members]
        return np.sum(outputs, axis=0)[:, 0, 0]

    def evaluate(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Value ``(B,)``, gradient ``(B, n)`` and Hessian ``(B, n, n)`` at rows x ``(B, n)``."""
        value, gradient, hessian = self.formulas(NUMPY, points[..., None])
        return value[:, 0, 0], gradient[:, 0], hessian

    def formulas(self, lib: Library, x: Any) -> tuple[Any, Any, Any]:
        """Value ``(..., 1, 1)``, gradient ``(..., 1, n)`` and Hessian ``(..., n, n)`` at x ``(..., n, 1)``."""
        (s, a, g), (d_s, d_a, d_g) = self._split(lib, x), self._split(lib, np.eye(self.n_inputs))
        policy_slopes, policy_tape = None, []
        if self.action_of == "policy":
            scaled_s, scaled_g, slope_s, slope_g = self._policy_scaling(lib, s, g, d_s, d_g)
            outputs, policy_slopes, policy_tape = self._policy.forward(
                lib, lib.stack(scaled_s, scaled_g), lib.stack(slope_s, slope_g)
            )
            a = lib.tanh(outputs)
            d_a = lib.rows(1.0 - a * a, policy_slopes)
        s, g, d_s, d_g = self._scaling(lib, s, g, d_s, d_g)
        if lib is NUMPY and self.action_of == "plan":
            d_a = np.broadcast_to(d_a, (*d_s.shape[:-2], *d_a.shape))
        inputs, moved = lib.stack(s, a, g), lib.stack(d_s, d_a, d_g)
        parts = [self._member(lib, member, inputs, moved) for member in self._members]
        value, gradient, multiplier, hessian = (sum(part[1:], part[0]) for part in zip(*parts, strict=True))
        if self.action_of == "policy":  # the curvature of a = tanh(outputs) and of the outputs, as far as d feels it
            of_action = lib.part(multiplier, self.n_observation, self.n_observation + self.n_action)
            slope = 1.0 - a * a
            bent = lib.rows(-2.0 * a * slope * of_action, policy_slopes)
            hessian = hessian + lib.product(lib.transpose(policy_slopes), bent)
            hessian = hessian + self._policy.curvature(lib, policy_tape, slope * of_action)[1]
        return value, gradient, hessian

    def _member(self, lib: Library, member: Network, inputs: Any, moved: Any) -> tuple[Any, Any, Any, Any]:
        """A member's share of value, gradient, slope with respect to scaled inputs, and Hessian."""
        raw, slopes, tape = member.forward(lib, inputs, moved)
        value, first, second = self._output(lib, raw)
        multiplier, hessian = member.curvature(lib, tape, first)
        return value, first * slopes, multiplier, hessian + second * lib.product(lib.transpose(slopes), slopes)

    def _split(self, lib: Library, x: Any) -> tuple[Any, Any, Any]:
        """Observation, action (nothing where the policy chooses it) and goal of x."""
        n, n_s, n_g = self.n_inputs, self.n_observation, self.n_goal
        return lib.part(x, 0, n_s), lib.part(x, n_s, n - n_g), lib.part(x, n - n_g, n)

    def _output(self, lib: Library, raw: Any) -> tuple[Any, Any, Any]:
        """Steps and their first two derivatives with respect to the network's last output."""
        length = self._steps
        if not self._softplus:
            return length * raw, length + 0.0 * raw, 0.0 * raw
        sigma = 0.5 * (1.0 + lib.tanh(0.5 * raw))
        softplus = lib.log1p_exp_minus(raw) + lib.positive(raw)
        return length * softplus, length * sigma, length * sigma * (1.0 - sigma)

    def function(self) -> casadi.Function:
        """The CasADi function x ``(n,)`` -> y ``()``, with these derivatives in place of CasADi's own."""
        n = self.n_inputs
        x, y, j = casadi.MX.sym("x", n), casadi.MX.sym("y"), casadi.MX.sym("j", 1, n)
        # CasADi silently prefers its own derivatives unless both directions are switched off.
        ours = {"never_inline": True, "enable_forward": False, "enable_reverse": False}
        value, gradient, hessian = self.formulas(CASADI, x)
        second = casadi.Function(
            "jac_jac_d", [x, y, j], [hessian, casadi.MX(n, 1)], ["x", "out_y", "out_jac_y_x"],
            ["jac_jac_y_x_x", "jac_jac_y_x_out_y"],
        )  # fmt: skip
        first = casadi.Function(
            "jac_d", [x, y], [gradient], ["x", "out_y"], ["jac_y_x"], {**ours, "custom_jacobian": second}
        )
        return casadi.Function("d", [x], [value], ["x"], ["y"], {**ours, "custom_jacobian": first})
