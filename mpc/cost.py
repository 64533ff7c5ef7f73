"""What a plan costs, in steps: steps spent outside the goal plus an estimate of steps to go.

    J(a_0 .. a_{H-1}) = sum_t 1[goal not reached at s_t] + to_go

The estimate of the steps to go is what the experiments compare: the learned distance,
Euclidean distance, or nothing at all (sparse).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, get_args

import numpy as np
import torch

from mpc.reading import ActionOf, Where
from mpc.rollout import Trajectories
from napsp.storage.checkpoint import Model


class StepsToGo(Protocol):
    """Estimates the steps from a state to the goal."""

    def __call__(
        self, observations: np.ndarray, achieved_goals: np.ndarray, actions: np.ndarray | None, goal: np.ndarray
    ) -> np.ndarray:
        """Steps ``(B,)`` from rows ``(B, O)``, ``(B, G)``, ``(B, A)`` to one goal ``(G,)``."""
        ...


class Reached(Protocol):
    """The environment's own success test."""

    def __call__(self, achieved_goal: np.ndarray, desired_goal: np.ndarray) -> np.ndarray:
        """Bool ``(...)`` for goals ``(..., G)``."""
        ...


class LearnedSteps:
    """d(s, a, g) of a trained model; without actions it asks the policy, a = pi(s, g).

        max_k d_k(s, a, g) + pessimism * U(N(s, a)),   U of eq. 2

    Both terms rise where the estimate is least to be trusted: where models disagree, and where
    training never went. Everything is asked at one action, the plan's or that of ``model``'s
    policy, since d is a function of it: another policy's action would be another question.

    Args:
        model: gives the policy, the counts N and the constants C and M of U.
        pessimism: weight of U; 0 needs no counts.
        ensemble: further models of the same task whose distances join the maximum.

    Raises:
        ValueError: a model holds no distance, or ``pessimism`` asks for counts that are not there.
    """

    def __init__(self, model: Model, pessimism: float = 0.0, ensemble: Sequence[Model] = ()) -> None:
        self._distances = [member.distance for member in (model, *ensemble) if member.distance is not None]
        if len(self._distances) <= len(ensemble):
            raise ValueError("a model holds no distance (it was trained with --method sparse)")
        if pessimism and model.visits is None:
            raise ValueError("the model holds no visit counts; train it again, or use an ensemble")
        self._policy, self._visits, self._uncertainty = model.policy, model.visits, model.config.uncertainty
        self._pessimism = pessimism

    def __call__(
        self, observations: np.ndarray, achieved_goals: np.ndarray, actions: np.ndarray | None, goal: np.ndarray
    ) -> np.ndarray:
        """Steps ``(B,)``, within [0, T] where ``pessimism`` is 0."""
        with torch.inference_mode():
            states = torch.from_numpy(np.ascontiguousarray(observations, np.float32))
            goals = torch.from_numpy(goal.astype(np.float32)).expand(len(states), -1)
            chosen = self._policy.mode(states, goals) if actions is None else torch.from_numpy(_float32(actions))
            found = [distance.steps(states, chosen, goals) for distance in self._distances]
            steps = torch.stack(found).amax(0).numpy().astype(np.float64)
        if self._pessimism and self._visits is not None:
            visits = self._visits(states.numpy(), chosen.numpy())
            steps += self._pessimism * self._uncertainty(visits)
        return steps


class EuclideanSteps:
    """Straight-line distance at full speed; blind to walls."""

    def __init__(self, step_length: float) -> None:
        self._step_length = step_length

    def __call__(
        self, observations: np.ndarray, achieved_goals: np.ndarray, actions: np.ndarray | None, goal: np.ndarray
    ) -> np.ndarray:
        """Steps ``(B,)``: metres to the goal over metres per control step."""
        return np.linalg.norm(achieved_goals - goal, axis=-1) / self._step_length


class GivenSteps:
    """An estimate that reads the achieved goal alone: true shortest paths, or a function of the user's own.

    Args:
        steps: maps achieved goals ``(B, G)`` and one goal ``(G,)`` to steps ``(B,)``.
    """

    def __init__(self, steps: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
        self._steps = steps

    def __call__(
        self, observations: np.ndarray, achieved_goals: np.ndarray, actions: np.ndarray | None, goal: np.ndarray
    ) -> np.ndarray:
        """Steps ``(B,)``."""
        steps = np.asarray(self._steps(achieved_goals, goal), np.float64)
        if steps.shape != (len(achieved_goals),):
            raise ValueError(f"the cost function returned shape {steps.shape}; it must return {(len(achieved_goals),)}")
        return steps


class NoSteps:
    """Zero: only reaching the goal within the horizon counts (sparse)."""

    def __call__(
        self, observations: np.ndarray, achieved_goals: np.ndarray, actions: np.ndarray | None, goal: np.ndarray
    ) -> np.ndarray:
        """Zeros ``(B,)``."""
        return np.zeros(len(observations))


@dataclass(frozen=True)
class Cost:
    """J of a batch of plans.

    Attributes:
        to_go: the estimate of steps to go.
        reached: the environment's success test.
        where: ``terminal`` reads the estimate at the end of the plan, ``mean`` averages it
            over states of the plan, ``both`` adds the two.
        n_averaged: at most this many states enter the average, evenly spaced and ending with
            the last, so that a long plan does not pay for d at states it hardly differs in.
        action_of: what goes in for a in d(s, a, g). ``policy``: a = pi(s, g), after all H
            actions are simulated. ``plan``: the plan's own action; the last one is then not
            simulated, and a horizon of 1 is argmin_a d(s, a, g) without any simulation.
    """

    to_go: StepsToGo
    reached: Reached
    where: Where = "mean"
    action_of: ActionOf = "policy"
    n_averaged: int = 8

    def __post_init__(self) -> None:
        for name, words in (("where", get_args(Where)), ("action_of", get_args(ActionOf))):
            if getattr(self, name) not in words:
                raise ValueError(f"unknown {name} {getattr(self, name)!r}; choose one of: {', '.join(words)}")

    def simulated_steps(self, horizon: int) -> int:
        """How many actions of a plan have to be simulated."""
        return horizon if self.action_of == "policy" else horizon - 1

    def weights(self, horizon: int) -> np.ndarray:
        """With what weight d at each state of a plan enters the cost, ``(H,)``.

        The states are s_1 .. s_H, or with ``action_of="plan"`` s_0 .. s_{H-1}.
        """
        weights = np.zeros(horizon)
        if self.where != "terminal":
            read = self._averaged(horizon)
            weights[read] = 1.0 / len(read)
        if self.where != "mean":
            weights[-1] += 1.0
        return weights

    def __call__(
        self, start: dict[str, np.ndarray], trajectories: Trajectories, actions: np.ndarray, goal: np.ndarray
    ) -> np.ndarray:
        """Costs ``(N,)`` in steps; +inf where the simulation diverged or d is not a number.

        Args:
            start: the environment's observation dictionary before the plan.
            trajectories: states s_1 .. s_n, n = :meth:`simulated_steps`.
            actions: ``(N, H, A)``.
            goal: ``(G,)``.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            outside = ~self.reached(
                trajectories.achieved_goals, np.broadcast_to(goal, trajectories.achieved_goals.shape)
            )
            spent = outside.sum(1).astype(np.float64)
            costs = spent + self._steps_to_go(start, trajectories, actions, goal, outside)
        return np.where(trajectories.diverged | ~np.isfinite(costs), np.inf, costs)

    def _steps_to_go(
        self,
        start: dict[str, np.ndarray],
        trajectories: Trajectories,
        actions: np.ndarray,
        goal: np.ndarray,
        outside: np.ndarray,
    ) -> np.ndarray:
        observations, achieved = trajectories.observations, trajectories.achieved_goals
        n_samples = len(actions)
        if self.action_of == "plan":  # states s_0 .. s_{H-1} with their own actions
            observations = _prepend(start["observation"], observations)
            achieved = _prepend(start["achieved_goal"], achieved)
            here = not self.reached(start["achieved_goal"], goal)
            outside = np.concatenate([np.full((n_samples, 1), here), outside], axis=1)
        read = [-1] if self.where == "terminal" else self._averaged(outside.shape[1])
        chosen = _rows(actions[:, read]) if self.action_of == "plan" else None
        steps = self.to_go(_rows(observations[:, read]), _rows(achieved[:, read]), chosen, goal)
        steps = steps.reshape(n_samples, -1)
        along = np.where(outside[:, read], steps, 0.0)
        # Once the plan has been at the goal there is nothing left to go at its end.
        at_end = np.where(outside.all(1), steps[:, -1], 0.0)
        if self.where == "terminal":
            return at_end
        return along.mean(1) + (at_end if self.where == "both" else 0.0)

    def _averaged(self, n_states: int) -> np.ndarray:
        """Indices of the states that are averaged, the last one included."""
        n = min(self.n_averaged, n_states)
        return n_states - 1 - np.round(np.arange(n)[::-1] * (n_states / n)).astype(int)


def _prepend(first: np.ndarray, rest: np.ndarray) -> np.ndarray:
    return np.concatenate([np.broadcast_to(first, (len(rest), 1, len(first))), rest], axis=1)


def _rows(batch: np.ndarray) -> np.ndarray:
    return batch.reshape(-1, batch.shape[-1])


def _float32(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, np.float32)
