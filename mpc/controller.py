"""The receding-horizon loop: sample, roll out, cost, update; execute one action; shift."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from mpc.cost import Cost
from mpc.knots import SplineConfig, interpolation_matrix, shift_matrix
from mpc.rollout import Actor, Followed, RolloutEngine, Trajectories
from mpc.simulators import State


class Planner(Protocol):
    """A search over knots ``(K, U)`` in [-1, 1]; see :class:`planners.mppi.MPPI`."""

    effective_samples: float

    @property
    def plan(self) -> np.ndarray:
        """The knots to execute, ``(K, U)``."""
        ...

    def reset(self) -> None:
        """Forget the plan."""
        ...

    def sample(self, rng: np.random.Generator, proposals: np.ndarray | None = None) -> np.ndarray:
        """Knots to try, ``(N, K, U)``; ``proposals`` ``(P, K, U)`` are among them."""
        ...

    def update(self, knots: np.ndarray, costs: np.ndarray) -> None:
        """Learn from their costs ``(N,)``."""
        ...

    def adopt(self, knots: np.ndarray) -> None:
        """Go on from this plan ``(K, U)``, which someone else found, keeping all else that was learned."""
        ...

    def shift(self, shift: np.ndarray) -> None:
        """Move the plan on by one control step."""
        ...


@dataclass(frozen=True)
class Smoothed:
    """What a smoother makes of a plan.

    Attributes:
        actions: the plan to execute, ``(H, A)``.
        cost: its true cost in steps, if it was rolled out.
        accepted: whether it differs from the sampled plan.
    """

    actions: np.ndarray
    cost: float | None
    accepted: bool


class Smoother(Protocol):
    """Smooths the chosen plan; see :class:`mpc.smoothing.layer.Smoother`."""

    def reset(self) -> None:
        """A new episode begins."""
        ...

    def skip(self, steps: int) -> None:
        """So many control steps went by unplanned."""
        ...

    def __call__(
        self, state: State, observation: dict[str, np.ndarray], actions: np.ndarray, executed: np.ndarray
    ) -> Smoothed:
        """Smooth ``actions`` ``(H, A)``; ``executed`` ``(k, A)``, k <= 2, are the last actions, the latest last."""
        ...


@dataclass(frozen=True)
class Plan:
    """The outcome of one plan call.

    Attributes:
        action: the action to execute now, ``(A,)``.
        actions: the whole plan, ``(H, A)``.
        trajectories: the last batch of rollouts, for pictures.
        costs: their costs in steps, ``(N,)``.
        effective_samples: how many samples the planner's update really used.
        milliseconds: wall time of the call.
        smoothing_ms: the part of it that went into smoothing.
    """

    action: np.ndarray
    actions: np.ndarray
    trajectories: Trajectories
    costs: np.ndarray
    effective_samples: float
    milliseconds: float
    smoothing_ms: float = 0.0

    def __repr__(self) -> str:
        """The action to take, and how the samples fared."""
        action = np.array2string(self.action, precision=3, suppress_small=True)
        best = self.costs[self.cheapest(1)].min(initial=np.inf)
        tried = f"{len(self.costs)} samples of {len(self.actions)} steps, the best costs {best:.2f}"
        return f"<plan: action {action}, {tried}, {self.milliseconds:.1f} ms>"

    def cheapest(self, n: int) -> np.ndarray:
        """Indices of the (at most) n samples of least cost, the best first; diverged ones are left out."""
        finite = np.flatnonzero(np.isfinite(self.costs))
        return finite[np.argsort(self.costs[finite])][:n]


class Controller:
    """Plans from the true state of an environment.

    Args:
        engine: exact batched rollouts of the environment's dynamics.
        planner: the search algorithm over the spline's knots.
        cost: the objective.
        horizon: H, control steps per plan.
        rng: source of all randomness of planning, until :meth:`reset` names another.
        spline: how many knots a plan has and how they become controls; default one per control step.
        n_refinements: sample-update rounds per plan call.
        proposals_from: actors, such as a policy, whose own rollouts join the samples.
        smoother: what smooths the plan before its first action is executed.
    """

    def __init__(
        self,
        engine: RolloutEngine,
        planner: Planner,
        cost: Cost,
        horizon: int,
        rng: np.random.Generator,
        spline: SplineConfig | None = None,
        n_refinements: int = 1,
        proposals_from: Sequence[Actor] = (),
        smoother: Smoother | None = None,
    ) -> None:
        self.engine, self.planner, self.cost = engine, planner, cost
        self.horizon, self.rng, self.n_refinements = horizon, rng, n_refinements
        spline = spline or SplineConfig()
        n_knots, interpolation = spline.knots or horizon, spline.interpolation
        self._to_actions = interpolation_matrix(n_knots, horizon, interpolation)
        self._to_knots = np.linalg.pinv(self._to_actions)
        self._shift = shift_matrix(n_knots, horizon, interpolation)
        self._proposals_from = proposals_from
        self.smoother = smoother
        self._executed: list[np.ndarray] = []
        self._shift_due = False
        self._warned = self._warned_of_proposals = False
        self.n_tried = 0  # plans simulated by the last plan call, smoothing left out

    def reset(self, rng: np.random.Generator | None = None) -> None:
        """Forget the last episode's plan; from here on draw from ``rng``, if one is given."""
        self.rng = rng or self.rng
        self.planner.reset()
        self.engine.reset()
        if self.smoother is not None:
            self.smoother.reset()
        self._executed = []
        self._shift_due = False

    def plan(self, env: Any, observation: dict[str, np.ndarray], executed: np.ndarray | None = None) -> Plan:
        """Plan from the current state of ``env`` (unwrapped), which is only read; for ``executed`` see the next one.

        Raises:
            ValueError: the engine's model has another state, or the desired goal is not finite.
        """
        return self.plan_from(self.engine.state_of(env), observation, executed)

    def plan_from(self, state: State, observation: dict[str, np.ndarray], executed: np.ndarray | None = None) -> Plan:
        """Plan from a full simulator state and the observation that belongs to it.

        ``executed`` ``(k, A)``, k <= 2, are the last actions, the latest last; None: the first ones of the last plans.

        Raises:
            ValueError: the desired goal is not finite.
        """
        started = time.perf_counter()
        goal = observation["desired_goal"]
        if not np.isfinite(goal).all():
            raise ValueError(f"the desired goal {goal} is not finite; give a finite goal")
        if self._shift_due:
            self.planner.shift(self._shift)
        self._shift_due = False  # until this plan is made: a call that fails is no step
        followed = [self.engine.follow(state, observation, actor, self.horizon) for actor in self._proposals_from]
        proposals = self._proposals(followed)
        n_simulated = self.cost.simulated_steps(self.horizon)
        self.n_tried = 0
        for _ in range(self.n_refinements):
            knots = self.planner.sample(self.rng, proposals)
            actions = self._actions(knots)
            self.n_tried += len(actions)
            trajectories = self.engine.rollout(state, actions[:, :n_simulated], followed)
            costs = self.cost(observation, trajectories, actions, goal)
            self.planner.update(knots, costs)
        self._warn_if_lost(costs, trajectories)
        plan, effective_samples = self._actions(self.planner.plan), self.planner.effective_samples
        sampled = time.perf_counter()
        if self.smoother is not None:
            last = np.array(self._executed, np.float32) if executed is None else executed
            plan = self._smooth(self.smoother, state, observation, plan, last.reshape(-1, plan.shape[1]))
        self._shift_due = True
        ended = time.perf_counter()
        return Plan(
            plan[0], plan, trajectories, costs, effective_samples, 1e3 * (ended - started), 1e3 * (ended - sampled)
        )

    def skip(self, steps: int) -> None:
        """Move the plan on by ``steps`` control steps that went by unplanned since the one that was planned last."""
        if not self._shift_due:
            return
        for _ in range(steps):
            self.planner.shift(self._shift)
        if self.smoother is not None:
            self.smoother.skip(steps)

    def cost_of(self, env: Any, observation: dict[str, np.ndarray], actions: np.ndarray) -> float:
        """What a plan ``(H, A)`` costs from the current state of ``env``, in steps, by rolling it out alone.

        That is in the model planned in; its own cost in the environment differs where that one is coarser.
        """
        return self.cost_from(self.engine.state_of(env), observation, actions)

    def cost_from(self, state: State, observation: dict[str, np.ndarray], actions: np.ndarray) -> float:
        """The same from a full simulator state and the observation that belongs to it."""
        plans, n_simulated = actions[None], self.cost.simulated_steps(self.horizon)
        trajectories = self.engine.rollout(state, plans[:, :n_simulated])
        return float(self.cost(observation, trajectories, plans, observation["desired_goal"])[0])

    def _smooth(
        self,
        smoother: Smoother,
        state: State,
        observation: dict[str, np.ndarray],
        plan: np.ndarray,
        executed: np.ndarray,
    ) -> np.ndarray:
        smoothed = smoother(state, observation, plan, executed)
        if smoothed.accepted and smoothed.cost is not None:
            # The next plan starts from it, or from the nearest that K knots can express: nobody rolled that one out,
            # so its cost is not handed over with it.
            self.planner.adopt(self._to_knots @ smoothed.actions)
        self._executed = [*self._executed[-1:], smoothed.actions[0].copy()]
        return smoothed.actions

    def _proposals(self, followed: Sequence[Followed]) -> np.ndarray | None:
        """Knots ``(P, K, U)`` of what actors did; one that answered NaN would spread it through the plan."""
        finite = [own.actions for own in followed if np.isfinite(own.actions).all()]
        if len(finite) < len(followed) and not self._warned_of_proposals:
            self._warned_of_proposals = True
            warnings.warn("a policy proposed actions that are not finite; left out", RuntimeWarning, stacklevel=4)
        return np.stack([self._to_knots @ actions for actions in finite]) if finite else None

    def _actions(self, knots: np.ndarray) -> np.ndarray:
        # float32 like the environments' action spaces: the plan is what will be executed.
        return np.clip(self._to_actions @ knots, -1.0, 1.0).astype(np.float32)

    def _warn_if_lost(self, costs: np.ndarray, trajectories: Trajectories) -> None:
        if not np.isfinite(costs).any() and not self._warned:
            self._warned = True
            diverged = trajectories.diverged.all()
            reason = "every sampled plan diverged" if diverged else "the cost of every sampled plan is not finite"
            warnings.warn(f"{reason}; keeping the previous plan", RuntimeWarning, stacklevel=4)
