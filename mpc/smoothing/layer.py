"""Smooth plans that still minimise the learned distance.

A sampling plan is jerky. This layer linearises the true simulator around it, solves for a smoother plan with d(s, a, g)
as cost, and rolls the answer out: it is kept only if the true objective did not rise.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from mpc.controller import Smoothed
from mpc.cost import Cost
from mpc.rollout import RolloutEngine
from mpc.simulators import State
from mpc.smoothing.config import SmoothingConfig
from mpc.smoothing.distance import SmoothDistance
from mpc.smoothing.linearise import Linearisation, linearise
from mpc.smoothing.problem import SOLVERS, Problem, Roughness, Solver, SolverError, action_rate
from mpc.smoothing.statistics import SmoothingStatistics
from napsp.storage.checkpoint import Model


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
        self.config = (config or SmoothingConfig()).resolved()
        self.engine, self.cost, self.horizon = engine, cost, horizon
        self.statistics = SmoothingStatistics()
        self.distance = SmoothDistance(model, cost.action_of)
        started = time.perf_counter()
        weights = cost.weights(horizon) if self.config.along else np.eye(horizon)[-1]
        self._read = np.flatnonzero(weights)
        self._weights = self.config.distance * weights[self._read]
        rate, jerk, effort = self.config.rate, self.config.jerk, self.config.effort
        self._roughness, self._choice = Roughness(rate, jerk, effort), self.config.choice or 1.0
        self._solved = [Roughness(multiple * rate, multiple * jerk, effort) for multiple in self.config.multiples or ()]
        self._solver: Solver = SOLVERS[self.config.solver](self.distance, horizon * n_actions, len(self._read))
        self.statistics.build_ms = 1e3 * (time.perf_counter() - started)
        self.reset()

    def reset(self) -> None:
        """A new episode: forget the last plan, and what was learned about the reach of the linear model."""
        self.trust = self.config.trust
        self._last: np.ndarray | None = None
        self._last_is_smooth = False

    def skip(self, steps: int) -> None:
        """Move the last plan on by ``steps`` control steps that went by unplanned."""
        if self._last is not None and steps:
            self._last = _later(self._last, steps)

    def __call__(
        self, state: State, observation: dict[str, np.ndarray], actions: np.ndarray, executed: np.ndarray
    ) -> Smoothed:
        """A smoother plan ``(H, A)``, or the given one.

        Args:
            state: full simulator state.
            observation: the environment's observation dictionary that belongs to it.
            actions: the sampled plan, ``(H, A)``.
            executed: the last actions, ``(k, A)``, k <= 2, the latest last.
        """
        self.statistics.n_calls += 1
        times = {"linearise": 0.0, "solve": 0.0, "verify": 0.0}
        with _clock(times, "verify"):
            task = self._start(state, observation, np.clip(actions, -1.0, 1.0), executed)
        for _ in range(self.config.rounds if np.isfinite(task.before) else 0):
            if not self._improve(task, times):
                break
        accepted = task.plan is not task.sampled
        self._last, self._last_is_smooth = task.plan, accepted or task.kept
        self.statistics.record(task.before, task.cost, accepted, task.kept, times)
        return Smoothed(task.plan, task.cost, accepted)

    def _start(
        self, state: State, observation: dict[str, np.ndarray], sampled: np.ndarray, executed: np.ndarray
    ) -> _Task:
        """Begin with the last smoothed plan, moved on in time, where the true objective prefers it to the sampled one.

        The search shakes its plan anew at every step. Where that brings nothing, least of all at the goal, there is no
        reason to follow it.
        """
        plans, kept = sampled[None], False
        if self._last is not None:
            held = _later(self._last, 1)
            plans = np.stack([sampled, held, 0.5 * (sampled + held)])
            kept = self._last_is_smooth and np.array_equal(sampled, held)
        costs = self._true_costs(state, observation, plans)
        before = float(costs[0])
        task = _Task(state, observation, executed, sampled, before, sampled, before, np.inf, kept=kept)
        task.merit = float(self._merit(plans[:1], costs[:1], executed)[0])
        task.rate = float(action_rate(sampled[None], executed)[0])
        self._choose(task, plans[1:], costs[1:])
        return task

    def _improve(self, task: _Task, times: dict[str, float]) -> bool:
        """Linearise, solve and verify once; whether that gave a better plan."""
        with _clock(times, "linearise"):
            n_simulated = self.cost.simulated_steps(self.horizon)
            linear = linearise(self.engine, task.state, task.plan, n_simulated, self.config.step)
        with _clock(times, "solve"):
            changes = self._changes(task, linear)
            if not changes:
                return False
        with _clock(times, "verify"):
            fractions = np.tile(self.FRACTIONS, len(changes))
            plans = task.plan + fractions[:, None, None] * np.repeat(changes, len(self.FRACTIONS), axis=0)
            plans = np.clip(plans, -1.0, 1.0).astype(task.plan.dtype)
            costs = self._true_costs(task.state, task.observation, plans)
            best = self._choose(task, plans, costs)
        # As large an answer as cost no more than the sampled plan this time is trusted the next time, whether it was
        # taken or, because there was nothing to smooth, not.
        right = fractions[costs <= task.before + self.config.tolerance].max(initial=0.5)
        factor = 1.5 if best is not None and fractions[best] == 1.0 else right
        self.trust = float(np.clip(factor * self.trust, self.MIN_TRUST, self.MAX_TRUST))
        return best is not None

    def _changes(self, task: _Task, linear: Linearisation) -> list[np.ndarray]:
        """Answers ``(H, A)``, one for each multiple of the roughness; problems that fail are counted."""
        found = []
        for roughness in self._solved:
            try:
                change = self._solver.solve(self._problem(task, linear, roughness))
            except (SolverError, RuntimeError, np.linalg.LinAlgError):  # CasADi raises RuntimeError
                self.statistics.n_solver_failures += 1
            else:
                found.append(change.reshape(task.plan.shape))
        return found

    def _choose(self, task: _Task, plans: np.ndarray, costs: np.ndarray) -> int | None:
        """Replace the task's plan by the best of ``plans`` that is allowed to; its index.

        Allowed is what costs no more than the sampled plan, improves on the best plan so far, and is smoother than the
        sampled plan (or need not be).
        """
        merit = self._merit(plans, costs, task.executed)
        allowed = (costs <= task.before + self.config.tolerance) & (merit < task.merit)
        if self.config.accept == "smoother":
            allowed &= action_rate(plans, task.executed) < task.rate
        if not allowed.any():
            return None
        best = int(np.argmin(np.where(allowed, merit, np.inf)))
        task.plan, task.cost, task.merit = plans[best], float(costs[best]), float(merit[best])
        return best

    def _true_costs(self, state: State, observation: dict[str, np.ndarray], plans: np.ndarray) -> np.ndarray:
        found = self.engine.rollout(state, plans[:, : self.cost.simulated_steps(self.horizon)])
        return self.cost(observation, found, plans, observation["desired_goal"])

    def _merit(self, plans: np.ndarray, costs: np.ndarray, executed: np.ndarray) -> np.ndarray:
        """What the problem minimises, with the true objective in place of the model's, and the weight of choice."""
        return self.config.distance * costs + self._choice * self._roughness(plans, executed)

    def _problem(self, task: _Task, linear: Linearisation, roughness: Roughness) -> Problem:
        observations, sensitivities = linear.nominal.observations[0], linear.sensitivities
        actions, goal = task.plan, task.observation["desired_goal"]
        n_readings, n_unknowns = len(self._read), actions.size
        if self.cost.action_of == "plan":
            observations = np.concatenate([task.observation["observation"][None], observations])
            sensitivities = np.concatenate([np.zeros((1, *sensitivities.shape[1:])), sensitivities])
        points, slopes = [observations[self._read]], [sensitivities[self._read]]
        if self.cost.action_of == "plan":
            points.append(actions[self._read])
            slopes.append(np.eye(n_unknowns).reshape(*actions.shape, n_unknowns)[self._read])
        points.append(np.broadcast_to(goal, (n_readings, len(goal))))
        slopes.append(np.zeros((n_readings, len(goal), n_unknowns)))
        matrix, gradient, _ = roughness.quadratic(actions, task.executed)
        lower, upper = np.maximum(-1.0 - actions, -self.trust), np.minimum(1.0 - actions, self.trust)
        return Problem(
            matrix, gradient, np.concatenate(points, 1).astype(float), np.concatenate(slopes, 1), self._weights,
            lower.ravel().astype(float), upper.ravel().astype(float),
        )  # fmt: skip


def _later(plan: np.ndarray, steps: int) -> np.ndarray:
    """A plan ``(H, A)`` read some steps later; past its end its last action is held."""
    return plan[np.minimum(np.arange(len(plan)) + steps, len(plan) - 1)]


@dataclass
class _Task:
    """One call's plan on its way: what was sampled, and the best so far."""

    state: State
    observation: dict[str, np.ndarray]
    executed: np.ndarray
    sampled: np.ndarray
    before: float
    plan: np.ndarray
    cost: float
    merit: float
    rate: float = np.inf
    kept: bool = False
    """The search handed back the layer's last plan, moved on by a step."""


@contextmanager
def _clock(times: dict[str, float], name: str) -> Iterator[None]:
    started = time.perf_counter()
    try:
        yield
    finally:
        times[name] += 1e3 * (time.perf_counter() - started)
