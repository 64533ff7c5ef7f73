"""Smooth plans that still minimise the learned distance.

A sampling plan is jerky. This layer linearises the true simulator around it, solves for a smoother plan with d(s, a, g)
as cost, and rolls the answer out: it is kept only if the true objective did not rise.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mpc.controller import Smoothed
from mpc.cost import Cost
from mpc.rollout import RolloutEngine, Trajectories
from mpc.smoothing_distance import SmoothDistance
from mpc.smoothing_linearise import Linearisation, linearise
from mpc.smoothing_problem import SOLVERS, Problem, Roughness, Solver, SolverError, action_rate
from napsp.checkpoint import Model


@dataclass(frozen=True)
class SmoothingConfig:
    """Settings of the layer; roughness is weighed in steps, the unit of d."""

    rate: float = 1.0
    """Weight of the mean squared change between neighbouring actions (times the horizon)."""
    jerk: float = 0.3
    """Weight of the squared change of that change."""
    effort: float = 0.01
    """Weight of the squared actions."""
    distance: float = 1.0
    """Weight of d."""
    along: bool = True
    """Read d where the planner's cost reads it; otherwise at the end of the plan only."""
    trust: float = 0.3
    """First bound on the change of an action; it then adapts between MIN_TRUST and MAX_TRUST."""
    rounds: int = 1
    """Linearise, solve, verify so many times per plan."""
    tolerance: float = 0.0
    """The true objective may rise by so many steps."""
    accept: Literal["smoother", "better"] = "smoother"
    """What a plan needs besides a cost that does not rise: a lower action rate, or a lower sum of cost and
    roughness (for the layer alone, which has to find the way as well)."""
    step: float = 0.1
    """Change of an action for the finite differences."""
    solver: Literal["qp", "ipopt"] = "qp"
    """Quadratic programs, or IPOPT."""


@dataclass
class SmoothingStatistics:
    """What happened so far; lists have one number per call, times are milliseconds."""

    n_calls: int = 0
    n_accepted: int = 0
    n_solver_failures: int = 0
    n_risen: int = 0
    """Accepted plans with a true objective above the one before: zero unless a tolerance is given."""
    before: list[float] = field(default_factory=list)
    after: list[float] = field(default_factory=list)
    linearise_ms: list[float] = field(default_factory=list)
    solve_ms: list[float] = field(default_factory=list)
    verify_ms: list[float] = field(default_factory=list)
    build_ms: float = 0.0

    def summary(self) -> dict[str, float]:
        """Shares and medians, for ``summary.json``."""
        parts = {name: getattr(self, name) for name in ("linearise_ms", "solve_ms", "verify_ms")}
        drop = np.subtract(self.before, self.after)
        return {
            "calls": self.n_calls,
            "accepted": self.n_accepted,
            "accepted_share": self.n_accepted / max(self.n_calls, 1),
            "risen": self.n_risen,
            "solver_failures": self.n_solver_failures,
            "mean_cost_drop": float(drop[np.isfinite(drop)].mean()) if np.isfinite(drop).any() else 0.0,
            "build_ms": self.build_ms,
            **{name: float(np.median(values)) if values else 0.0 for name, values in parts.items()},
        }


class Smoother:
    """The layer around one engine, cost and model; use it for plans of one horizon.

    Args:
        engine: the planner's own simulator.
        cost: the true objective, the planner's own.
        model: its d, and the policy inside d where the cost asks for it.
        horizon: H.
        n_actions: A.
        config: settings.
    """

    FRACTIONS = (1.0, 0.5, 0.25, 0.1)
    MIN_TRUST, MAX_TRUST = 0.05, 1.0

    def __init__(
        self,
        engine: RolloutEngine,
        cost: Cost,
        model: Model,
        horizon: int,
        n_actions: int,
        config: SmoothingConfig | None = None,
    ) -> None:
        self.config = config or SmoothingConfig()
        self.engine, self.cost, self.horizon = engine, cost, horizon
        self.statistics = SmoothingStatistics()
        self.distance = SmoothDistance(model, cost.action_of)
        started = time.perf_counter()
        weights = cost.weights(horizon) if self.config.along else np.eye(horizon)[-1]
        self._read = np.flatnonzero(weights)
        self._weights = self.config.distance * weights[self._read]
        self._roughness = Roughness(self.config.rate, self.config.jerk, self.config.effort)
        self._solver: Solver = SOLVERS[self.config.solver](self.distance, horizon * n_actions, len(self._read))
        self.statistics.build_ms = 1e3 * (time.perf_counter() - started)
        self.reset()

    def reset(self) -> None:
        """A new episode: forget what was learned about the reach of the linear model."""
        self.trust = self.config.trust

    def __call__(
        self, state: np.ndarray, observation: dict[str, np.ndarray], actions: np.ndarray, executed: np.ndarray
    ) -> Smoothed:
        """A smoother plan ``(H, A)``, or the given one.

        Args:
            state: full simulator state.
            observation: the environment's observation dictionary that belongs to it.
            actions: the sampled plan, ``(H, A)``.
            executed: the last actions, ``(k, A)``, k <= 2, the latest last.
        """
        self.statistics.n_calls += 1
        current = Smoothed(np.clip(actions, -1.0, 1.0), None, False)
        times = np.zeros(3)
        first = np.nan
        for _ in range(self.config.rounds):
            outcome = self._round(state, observation, current.actions, executed, times)
            first = outcome[1] if np.isnan(first) else first
            if outcome[0] is None:
                break
            current = outcome[0]
        self._record(current, first, times)
        return current

    def _round(
        self,
        state: np.ndarray,
        observation: dict[str, np.ndarray],
        actions: np.ndarray,
        executed: np.ndarray,
        times: np.ndarray,
    ) -> tuple[Smoothed | None, float]:
        """One linearisation; the better plan, or None, and the true objective before."""
        started = time.perf_counter()
        goal, n_simulated = observation["desired_goal"], self.cost.simulated_steps(self.horizon)
        linear = linearise(self.engine, state, actions, n_simulated, self.config.step)
        before = float(self.cost(observation, linear.nominal, actions[None], goal)[0])
        times[0] += 1e3 * (time.perf_counter() - started)
        if not np.isfinite(before):
            return None, before
        started = time.perf_counter()
        try:
            change = self._solver.solve(self._problem(observation, linear, actions, executed, goal))
        except (SolverError, RuntimeError, np.linalg.LinAlgError):  # CasADi raises RuntimeError
            self.statistics.n_solver_failures += 1
            return None, before
        finally:
            times[1] += 1e3 * (time.perf_counter() - started)
        started = time.perf_counter()
        outcome = self._verify(state, observation, actions, executed, change.reshape(actions.shape), before)
        times[2] += 1e3 * (time.perf_counter() - started)
        return outcome, before

    def _problem(
        self,
        observation: dict[str, np.ndarray],
        linear: Linearisation,
        actions: np.ndarray,
        executed: np.ndarray,
        goal: np.ndarray,
    ) -> Problem:
        observations, sensitivities = linear.nominal.observations[0], linear.sensitivities
        n_readings, n_unknowns = len(self._read), actions.size
        if self.cost.action_of == "plan":
            observations = np.concatenate([observation["observation"][None], observations])
            sensitivities = np.concatenate([np.zeros((1, *sensitivities.shape[1:])), sensitivities])
        points, slopes = [observations[self._read]], [sensitivities[self._read]]
        if self.cost.action_of == "plan":
            points.append(actions[self._read])
            slopes.append(np.eye(n_unknowns).reshape(*actions.shape, n_unknowns)[self._read])
        points.append(np.broadcast_to(goal, (n_readings, len(goal))))
        slopes.append(np.zeros((n_readings, len(goal), n_unknowns)))
        matrix, gradient, _ = self._roughness.quadratic(actions, executed)
        lower, upper = np.maximum(-1.0 - actions, -self.trust), np.minimum(1.0 - actions, self.trust)
        return Problem(
            matrix, gradient, np.concatenate(points, 1).astype(float), np.concatenate(slopes, 1), self._weights,
            lower.ravel().astype(float), upper.ravel().astype(float),
        )  # fmt: skip

    def _verify(
        self,
        state: np.ndarray,
        observation: dict[str, np.ndarray],
        actions: np.ndarray,
        executed: np.ndarray,
        change: np.ndarray,
        before: float,
    ) -> Smoothed | None:
        """The best of the shortened changes that the true simulator and objective agree with."""
        plans = actions + np.array(self.FRACTIONS)[:, None, None] * change
        plans = np.clip(plans, -1.0, 1.0).astype(actions.dtype)
        n_simulated = self.cost.simulated_steps(self.horizon)
        found: Trajectories = self.engine.rollout(state, plans[:, :n_simulated])
        costs = self.cost(observation, found, plans, observation["desired_goal"])
        allowed = costs <= before + self.config.tolerance
        merit = self.config.distance * costs + self._roughness(plans, executed)
        if self.config.accept == "smoother":
            allowed &= action_rate(plans, executed) < action_rate(actions[None], executed)
        else:
            allowed &= merit < self.config.distance * before + self._roughness(actions[None], executed)
        if not allowed.any():
            self.trust = max(self.MIN_TRUST, 0.5 * self.trust)
            return None
        best = int(np.argmin(np.where(allowed, merit, np.inf)))
        factor = 1.5 if best == 0 else max(self.FRACTIONS[best], 0.5)
        self.trust = float(np.clip(factor * self.trust, self.MIN_TRUST, self.MAX_TRUST))
        return Smoothed(plans[best], float(costs[best]), True)

    def _record(self, result: Smoothed, before: float, times: np.ndarray) -> None:
        s = self.statistics
        after = before if result.cost is None else result.cost
        s.n_accepted += result.accepted
        s.n_risen += bool(after > before)
        s.before.append(before)
        s.after.append(after)
        for name, value in zip(("linearise_ms", "solve_ms", "verify_ms"), times, strict=True):
            getattr(s, name).append(float(value))
