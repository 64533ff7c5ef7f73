"""Wrappers around a task: plans are made in the task itself, so what a wrapper changes would be left out of them."""

from __future__ import annotations

from typing import Any

import gymnasium
from gymnasium import wrappers

from napsp.errors import UserError

STANDARD = (wrappers.TimeLimit, wrappers.OrderEnforcing, wrappers.PassiveEnvChecker)  # gymnasium.make's own
LOOKERS = (
    wrappers.RecordEpisodeStatistics,
    wrappers.RecordVideo,
    wrappers.HumanRendering,
    wrappers.RenderCollection,
)


def unwrapped(name: str, env: gymnasium.Env, lookers: bool) -> gymnasium.Env:
    """An environment without gymnasium.make's own wrappers, but with those that only look on.

    Args:
        name: what the user calls it.
        env: with any wrappers.
        lookers: whether wrappers that look on are kept; else they are refused as well.

    Raises:
        UserError: another wrapper is around it.
    """
    own, around = env.unwrapped, wrappers_around(env)
    around = [wrapper for wrapper in around if not isinstance(wrapper, STANDARD)]
    others = [type(wrapper).__name__ for wrapper in around if not (lookers and isinstance(wrapper, LOOKERS))]
    if others:
        raise UserError(
            f"{name} is wrapped in {', '.join(others)}, which plans would not pass through; let the environment itself "
            "do what they do (actions in dynamics.control, goals and starts in reset), and make it without them"
        )
    env = own
    for wrapper in reversed(around):
        wrapper.env = env
        env = wrapper
    return env


def wrappers_around(env: gymnasium.Env) -> list[Any]:
    """All of them, the outermost first."""
    own, around = env.unwrapped, []
    while env is not own:
        around.append(env)
        env = env.env  # type: ignore[attr-defined]
    return around
