"""The smoothing problem around one plan, and two ways to solve it.

    min over du   rate + jerk + effort of u + du   +   sum_r w_r d(x_r + M_r du)
    within        lower <= du <= upper

The plan's states enter through their sensitivities (single shooting): du is the only unknown.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import casadi
import numpy as np

from mpc.smoothing.distance import SmoothDistance


@dataclass(frozen=True)
class Roughness:
    """How rough a plan ``u`` ``(H, A)`` is after the actions executed before it, as a quadratic.

    Attributes:
        rate: weight of the squared change from one action to the next, in steps.
        jerk: weight of the squared change of that change.
        effort: weight of the squared action.
    """

    rate: float
    jerk: float
    effort: float

    def quadratic(self, actions: np.ndarray, executed: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Matrix ``(H A, H A)``, gradient ``(H A,)`` and value at du = 0.

        ``executed`` ``(k, A)``, the latest last, are the actions before the plan; with none of them the plan may
        start anywhere.
        """
        horizon, n_actions = actions.shape
        matrix, gradient, value = 2.0 * self.effort * np.eye(horizon), 2.0 * self.effort * actions, 0.0
        value = self.effort * np.square(actions).sum()
        joined = np.concatenate([executed, actions]).astype(float)
        for order, weight in ((1, self.rate), (2, self.jerk)):
            differences = np.diff(np.eye(len(joined)), order, axis=0)
            values = differences @ joined
            own = differences[:, len(executed) :]
            # Differences between executed actions alone are constants.
            value += weight * np.square(values[own.any(1)]).sum()
            matrix = matrix + 2.0 * weight * own.T @ own
            gradient = gradient + 2.0 * weight * own.T @ values
        return np.kron(matrix, np.eye(n_actions)), gradient.ravel(), float(value)

    def __call__(self, plans: np.ndarray, executed: np.ndarray) -> np.ndarray:
        """Values ``(N,)`` of plans ``(N, H, A)``."""
        return np.array([self.quadratic(plan, executed)[2] for plan in plans])


def action_rate(plans: np.ndarray, executed: np.ndarray) -> np.ndarray:
    """Mean squared change ``(N,)`` between neighbouring actions of plans ``(N, H, A)``, the last executed included."""
    before = np.broadcast_to(executed[-1:], (len(plans), len(executed[-1:]), plans.shape[-1]))
    changes = np.diff(np.concatenate([before, plans], axis=1).astype(float), axis=1)
    return np.square(changes).sum(-1).mean(-1) if changes.shape[1] else np.zeros(len(plans))


@dataclass(frozen=True)
class Problem:
    """The numbers of one problem with N unknowns and R readings of d.

    Attributes:
        matrix: of the roughness, ``(N, N)``.
        gradient: of the roughness, ``(N,)``.
        points: what d reads before the change, ``(R, n)``; see :class:`SmoothDistance`.
        slopes: how that answers du, ``(R, n, N)``.
        weights: of the readings, ``(R,)``.
        lower, upper: bounds of du, ``(N,)``; zero lies between them.
    """

    matrix: np.ndarray
    gradient: np.ndarray
    points: np.ndarray
    slopes: np.ndarray
    weights: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def value(self, distance: SmoothDistance, changes: np.ndarray) -> np.ndarray:
        """Objective ``(C,)`` of changes ``(C, N)``, less the constant roughness at zero."""
        points = self.points + np.einsum("rnk,ck->crn", self.slopes, changes)
        steps = distance.values(points.reshape(-1, points.shape[-1])).reshape(len(changes), -1)
        quadratic = 0.5 * np.einsum("ci,ij,cj->c", changes, self.matrix, changes) + changes @ self.gradient
        return quadratic + steps @ self.weights


class SolverError(Exception):
    """No usable answer."""


class Solver(Protocol):
    """Solves one problem after the other; built once."""

    def solve(self, problem: Problem) -> np.ndarray:
        """The change du ``(N,)``.

        Raises:
            SolverError: no usable answer.
        """
        ...


class QuadraticSolver:
    """A few quadratic programs with the exact Hessian of d, its negative curvature cut off.

    d is not convex. Its Hessian at each reading is small, so its eigenvalues are clipped there at zero; what is left
    is convex for any horizon and a step along it goes downhill. The step is then shortened on the model itself.
    """

    STEPS = np.array([1.0, 0.5, 0.25, 0.1, 0.03])

    def __init__(self, distance: SmoothDistance, n_unknowns: int, n_readings: int, iterations: int = 3) -> None:
        self._distance, self._iterations = distance, iterations
        sparsity = {"h": casadi.Sparsity.dense(n_unknowns, n_unknowns), "a": casadi.Sparsity(0, n_unknowns)}
        self._program = casadi.conic("smoothing", "daqp", sparsity, {"error_on_fail": False})
        self._floor = 1e-6 * np.eye(n_unknowns)

    def solve(self, problem: Problem) -> np.ndarray:
        """The change du ``(N,)``."""
        change = np.zeros(len(problem.lower))
        value = None
        for _ in range(self._iterations):
            points = problem.points + problem.slopes @ change
            steps, slopes, hessians = self._distance.evaluate(points)
            if value is None:
                value = float(steps @ problem.weights)
            gradient = problem.matrix @ change + problem.gradient
            gradient = gradient + np.einsum("r,rn,rnk->k", problem.weights, slopes, problem.slopes)
            if not (np.isfinite(gradient).all() and np.isfinite(hessians).all()):
                raise SolverError("numbers that are not finite")
            root = _positive_roots(hessians) @ problem.slopes * np.sqrt(problem.weights)[:, None, None]
            root = root.reshape(-1, len(change))
            step = self._step(problem.matrix + root.T @ root + self._floor, gradient, problem, change)
            trials = change + self.STEPS[:, None] * step
            values = problem.value(self._distance, trials)
            best = int(np.argmin(np.where(np.isfinite(values), values, np.inf)))
            if not values[best] < value:
                break
            gained, change, value = value - values[best], trials[best], float(values[best])
            if gained < 1e-3:
                break
        return change

    def _step(self, matrix: np.ndarray, gradient: np.ndarray, problem: Problem, change: np.ndarray) -> np.ndarray:
        answer = self._program(h=matrix, g=gradient, lbx=problem.lower - change, ubx=problem.upper - change)
        step = np.array(answer["x"]).ravel()
        if not self._program.stats()["success"] or not np.isfinite(step).all():
            raise SolverError("the quadratic program has no answer")
        return step


class InteriorPointSolver:
    """IPOPT on the problem itself, d embedded as a CasADi function."""

    def __init__(self, distance: SmoothDistance, n_unknowns: int, n_readings: int, iterations: int = 50) -> None:
        function, n, mx = distance.function(), distance.n_inputs, casadi.MX.sym
        change, matrix, gradient = mx("du", n_unknowns), mx("H", n_unknowns, n_unknowns), mx("g", n_unknowns)
        points, slopes = mx("x", n * n_readings), mx("M", n * n_readings, n_unknowns)
        weights = mx("w", n_readings)
        moved = points + casadi.mtimes(slopes, change)
        objective = 0.5 * casadi.bilin(matrix, change, change) + casadi.dot(gradient, change)
        for r in range(n_readings):
            objective += weights[r] * function(moved[n * r : n * (r + 1)])
        parameters = casadi.veccat(matrix, gradient, points, slopes, weights)
        quiet = {"print_level": 0, "sb": "yes", "tol": 1e-4, "max_iter": iterations}
        self._program = casadi.nlpsol(
            "smoothing", "ipopt", {"x": change, "p": parameters, "f": objective},
            {"print_time": False, "error_on_fail": False, "ipopt": quiet},
        )  # fmt: skip

    def solve(self, problem: Problem) -> np.ndarray:
        """The change du ``(N,)``."""
        slopes = problem.slopes.reshape(-1, problem.slopes.shape[-1])
        parts = problem.matrix, problem.gradient, problem.points.ravel()[:, None], slopes, problem.weights
        numbers = np.concatenate([np.ravel(part, order="F") for part in parts])
        if not np.isfinite(numbers).all():
            raise SolverError("numbers that are not finite")
        answer = self._program(x0=0.0, p=numbers, lbx=problem.lower, ubx=problem.upper)
        change = np.array(answer["x"]).ravel()
        # A run cut short by its limit still offers a change; rolling it out decides. A limit on time would make plans
        # depend on what else the machine does.
        usable = ("Solve_Succeeded", "Solved_To_Acceptable_Level", "Maximum_Iterations_Exceeded")
        if self._program.stats()["return_status"] not in usable or not np.isfinite(change).all():
            raise SolverError(f"IPOPT: {self._program.stats()['return_status']}")
        return np.clip(change, problem.lower, problem.upper)  # IPOPT relaxes bounds by about 1e-8


SOLVERS = {"qp": QuadraticSolver, "ipopt": InteriorPointSolver}


def _positive_roots(hessians: np.ndarray) -> np.ndarray:
    """R ``(..., n, n)`` with R'R = the Hessian without its negative curvature."""
    values, vectors = np.linalg.eigh(hessians)
    return np.sqrt(np.maximum(values, 0.0))[..., None] * np.swapaxes(vectors, -1, -2)
