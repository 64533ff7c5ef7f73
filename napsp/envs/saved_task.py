"""A goal environment that saves and restores its state, with what planners ask of a task; training needs none of it."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable
from multiprocessing.reduction import ForkingPickler
from typing import Any

import gymnasium
import numpy as np

from napsp.envs.goal_check import check_behaviour, check_spaces
from napsp.envs.goal_wrapper import GoalTask
from napsp.envs.saved import SavedDynamics, saved_state
from napsp.envs.success import SuccessTest, radius_of, success_test
from napsp.errors import UserError, describe_failure

N_MEASURED, N_HELD = 8, 10  # episodes, and steps in each, that tell how far a step goes


class SavedTask(GoalTask):
    """A goal environment with the interface of this package's tasks; plans read its state by ``get_state``.

    ``step_length`` and ``goal_radius`` are the environment's own attributes where it has them.

    Args:
        env: with wrappers that only look on.
        test: tells for pairs of goals ``(n, G)`` whether they are reached, bool ``(n,)``.
        make: makes another instance, without wrappers.
        radius: within which a goal counts as reached, in units of the goal; None where nobody knows.
    """

    task_name: str | None = None
    """What the user calls it."""
    model = data = None
    goal_unit = ""
    """Of gaps that are shown: nobody knows it."""

    def __init__(
        self, env: gymnasium.Env, test: SuccessTest, make: Callable[[], gymnasium.Env], radius: float | None
    ) -> None:
        super().__init__(env, test)
        spaces: Any = env.observation_space
        sizes = spaces["observation"].shape[0], spaces["achieved_goal"].shape[0]
        self._make = lambda: GoalTask(make(), test)
        self.dynamics = SavedDynamics(self._make, sizes)
        self.goal_radius: float | None = getattr(env.unwrapped, "goal_radius", radius)
        self._step_length: float | None = getattr(env.unwrapped, "step_length", None)

    @property
    def unwrapped(self) -> gymnasium.Env:
        """The task itself: what is inside takes other actions."""
        return self

    @property
    def goal(self) -> np.ndarray:
        """The environment's attribute ``goal``, if it has one."""
        return self.env.unwrapped.goal  # type: ignore[attr-defined]

    @goal.setter
    def goal(self, goal: np.ndarray) -> None:
        self.env.unwrapped.goal = goal  # type: ignore[attr-defined]

    @property
    def step_length(self) -> float:
        """How far a control step takes the achieved goal at most, for the straight line to a goal.

        The longest step of a few episodes, on another instance, that each hold a corner of the action box.

        Raises:
            UserError: none of them moved it.
        """
        if self._step_length is None:
            self._step_length = _longest_step(self._make())
        if not self._step_length > 0:
            raise UserError(
                f"how far a step of {self.task_name or 'the environment'} goes is not known, since none that was tried "
                "moved its achieved goal; give its class the attribute step_length, or choose another --cost"
            )
        return self._step_length

    def goal_positions(self, goals: np.ndarray) -> np.ndarray:
        """First three coordinates of goals ``(..., G)``, padded with zeros, for gaps."""
        missing = max(0, 3 - goals.shape[-1])
        return np.pad(goals[..., :3], [(0, 0)] * (goals.ndim - 1) + [(0, missing)])


def saved_task(name: str, env: gymnasium.Env, reached: str | None, make: Callable[[], gymnasium.Env]) -> SavedTask:
    """The task of an environment that :func:`saves_state`.

    Args:
        name: what the user calls it.
        env: with wrappers that only look on.
        reached: its success test, see :func:`napsp.envs.success.success_test`.
        make: makes another instance, without wrappers.

    Raises:
        UserError: it is no goal environment, or one of its methods fails; the sentence says what is missing.
    """
    check_spaces(env, name)
    task = SavedTask(env, success_test(env, name, reached), make, radius_of(reached))
    task.task_name = name
    if (name, reached) not in _CHECKED:  # on others, so that the task handed out begins as its class made it
        one, other = make(), make()
        try:
            check_behaviour(one, name, success_test(one, name, reached), reached is None)
            _check_state(one, other, name)
        finally:
            one.close()
            other.close()
        _CHECKED.add((name, reached))
    return task


_CHECKED: set[tuple[str, str | None]] = set()


def _check_state(one: Any, other: Any, name: str) -> None:
    """Let ``other`` go on from a state of ``one``; what that leads to is compared before plans are made."""
    one.reset(seed=0)
    other.reset(seed=1)
    doing = "get_state()"
    try:
        saved = saved_state(one)
        ForkingPickler.dumps(saved)  # as it goes to helper processes
        doing = "set_state(state)"
        other.set_state(copy.deepcopy(saved))
    except Exception as error:
        hint = "; let it return what pickle can copy" if doing == "get_state()" else ""
        raise UserError(f"{doing} of {name} failed with {describe_failure(error)}{hint}") from error
    action = one.action_space.low
    goals = [env.step(action)[0]["desired_goal"] for env in (one, other)]
    if not np.array_equal(*goals):
        warnings.warn(
            f"{name}: after set_state(state) the desired goal is another; let get_state() hold it as well",
            RuntimeWarning,
            stacklevel=4,
        )


def _longest_step(task: GoalTask) -> float:
    rng, longest, n_actions = np.random.default_rng(0), 0.0, task.action_space.shape[0]  # type: ignore[index]
    for seed in range(N_MEASURED):
        place = np.array(task.reset(seed=seed)[0]["achieved_goal"], np.float64)
        action = rng.choice([-1.0, 1.0], n_actions)
        for _ in range(N_HELD):
            observation, _, terminated, truncated, _ = task.step(action)
            before, place = place, np.array(observation["achieved_goal"], np.float64)
            moved = float(np.linalg.norm(place - before))
            longest = max(longest, moved if np.isfinite(moved) else 0.0)
            if terminated or truncated:
                break
    task.close()
    return longest
