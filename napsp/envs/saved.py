"""Any goal environment that can save and restore its state as a task to plan in: no MuJoCo, no dynamics.

It offers ``get_state()``, all that its next step reads, and ``set_state(state)``. Plans are simulated by stepping other
instances of it, so they are as exact as the state is complete, and as fast as its own ``step``.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from napsp.envs.goal_wrapper import GoalTask

PROTOCOL = ("get_state", "set_state")


@dataclass(frozen=True)
class Moment:
    """What a simulation starts from.

    Attributes:
        saved: a copy of what ``get_state`` answered: no simulation shares parts of it with the environment.
        end: features ``(F,)`` that stay, once the episode has ended; None while it goes on.
        crashed: whether it ended elsewhere than at its desired goal.
    """

    saved: Any
    end: np.ndarray | None = None
    crashed: bool = False


class SavedSimulator:
    """An instance of the environment, put into one state after the other.

    Where it terminates at its desired goal, later steps stay there. Where it terminates elsewhere, or answers numbers
    that are not finite, no plan may lead. That it truncates means nothing here: plans end by themselves.

    Args:
        task: around that instance, which nobody else steps.
        n_features: F.
    """

    def __init__(self, task: GoalTask, n_features: int) -> None:
        self._task, self._world = task, task.env.unwrapped
        self._end, self._crashed = np.zeros(n_features), False
        self._world.reset(seed=0)  # all alike, whatever their states leave out

    def begin(self, state: Moment) -> None:
        """Restore a state."""
        self._world.set_state(copy.deepcopy(state.saved))  # type: ignore[attr-defined]
        self._end, self._crashed = state.end, state.crashed

    def advance(self, controls: np.ndarray, features: np.ndarray) -> None:
        """Take actions ``(n, A)`` in [-1, 1] one after the other; write features ``(n, O + G)``."""
        for control, row in zip(controls, features, strict=True):
            if self._end is not None:
                row[:] = self._end
                continue
            found, _, terminated, _, _ = self._world.step(self._task.own_action(control))
            np.concatenate((found["observation"], found["achieved_goal"]), out=row)
            finite = np.isfinite(row).all()
            if terminated or not finite:
                arrived = finite and self._task.reached(found["achieved_goal"], found["desired_goal"])
                self._end, self._crashed = row.copy(), not arrived

    def blew_up(self) -> bool:
        """Whether it has ended elsewhere than at its desired goal."""
        return self._crashed

    def state(self) -> Moment:
        """Where it is now."""
        return Moment(saved_state(self._world), self._end, self._crashed)


class SavedDynamics:
    """A control row is the action; features are observation and achieved goal.

    Args:
        make: makes another instance of the environment, without wrappers and as a task.
        sizes: of observation and goal.
    """

    model, substeps, open_loop = None, 1, False

    def __init__(self, make: Callable[[], GoalTask], sizes: tuple[int, int]) -> None:
        self._make, self._n_observation, self.n_features = make, sizes[0], sum(sizes)

    def simulator(self) -> SavedSimulator:
        """What one worker simulates with, see :mod:`mpc.simulators`."""
        return SavedSimulator(self._make(), self.n_features)

    def state_of(self, world: gymnasium.Env) -> Moment:
        """The state of a :class:`napsp.envs.saved_task.SavedTask`."""
        return Moment(saved_state(world.env.unwrapped))  # type: ignore[attr-defined]

    def control(self, actions: np.ndarray) -> np.ndarray:
        """Actions ``(..., A)`` clipped to [-1, 1]; the environment's own box is the task's matter."""
        return np.clip(np.asarray(actions, np.float64), -1.0, 1.0)

    def observe(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Observation ``(..., O)`` and achieved goal ``(..., G)``."""
        return features[..., : self._n_observation].copy(), features[..., self._n_observation :].copy()


def saves_state(world: Any) -> bool:
    """Whether an environment (unwrapped) offers both methods."""
    return all(callable(getattr(world, method, None)) for method in PROTOCOL)


def saved_state(world: Any) -> Any:
    """A copy of the state of an environment (unwrapped), which goes on without it."""
    return copy.deepcopy(world.get_state())
