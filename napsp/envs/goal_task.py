"""Any Gymnasium goal environment as a task to train on: no MuJoCo, no dynamics, wrappers as they are.

Planning needs more, see :func:`napsp.envs.make`.
"""

from __future__ import annotations

from typing import Any

import gymnasium
from gymnasium.wrappers import TimeLimit

from napsp import envs as tasks
from napsp.envs.cards import CARDS
from napsp.envs.goal_check import check_behaviour, check_spaces
from napsp.envs.goal_wrapper import GoalTask
from napsp.envs.success import success_test
from napsp.envs.wrappers import LOOKERS, STANDARD, wrappers_around


def own_box(env: gymnasium.Env) -> list[list[float]] | None:
    """Least and largest actions of the environment inside a :class:`GoalTask`; None of other tasks."""
    while isinstance(env, TimeLimit):
        env = env.env
    if not isinstance(env, GoalTask):
        return None
    box: Any = env.env.action_space
    return [box.low.tolist(), box.high.tolist()]


def is_goal_task(env: gymnasium.Env) -> bool:
    """Whether an environment, time limits apart, is a :class:`GoalTask`."""
    return own_box(env) is not None


def make_goal_task(name: str, reached: str | None = None, **kwargs: Any) -> gymnasium.Env:
    """Create a task to train on, with its time limit: where it can be planned in, what planning simulates.

    Args:
        name: of a task, a Gymnasium id, ``package:id`` or ``module:Class``.
        reached: its success test, see :func:`napsp.envs.success.success_test`.
        kwargs: of the environment's class.

    Raises:
        UserError: unknown, or no goal environment; the sentence says what is missing.
    """
    name = tasks.canonical_name(name)
    if name in CARDS or _plannable(env := tasks.create(name, **kwargs)):
        if name not in CARDS:
            env.close()  # it showed what it is; planning makes its own
        tasks.refuse_test(name, reached)
        return tasks.make(name, **kwargs)
    check_spaces(env, name)
    task = GoalTask(env, success_test(env, name, reached))
    if (name, reached) not in _CHECKED:
        tried = tasks.create(name, **kwargs)  # another one, so that the task handed out begins as its class made it
        try:
            check_behaviour(tried, name, success_test(tried, name, reached), reached is None)
        finally:
            tried.close()
        _CHECKED.add((name, reached))
    return TimeLimit(task, tasks.episode_length(name))


_CHECKED: set[tuple[str, str | None]] = set()


def saves_its_state(name: str, **kwargs: Any) -> bool:
    """Whether a task can be planned in, by its state: it has no dynamics, and wrappers only look on.

    Args:
        name: canonical.
        kwargs: of the environment's class.
    """
    if name in CARDS:
        return False
    env = tasks.create(name, **kwargs)
    env.close()  # it showed what it is
    changed = [wrapper for wrapper in wrappers_around(env) if not isinstance(wrapper, (*STANDARD, *LOOKERS))]
    return tasks.plans_by_state(env) and not changed


def _plannable(env: gymnasium.Env) -> bool:
    """Whether planning simulates an environment as it is; it knows nothing of wrappers."""
    from napsp.envs.stock import FAMILIES  # gymnasium-robotics takes a while to import

    bare, world = env, env.unwrapped
    known = not tasks.lacks(world)
    while isinstance(bare, (*STANDARD, *(LOOKERS if known else ()))):
        bare = bare.env  # type: ignore[attr-defined]
    return bare is world and (known or isinstance(world, tuple(kind for kind, _ in FAMILIES)))
