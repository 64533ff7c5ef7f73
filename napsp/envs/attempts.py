"""Trying members of the user's own environment: what fails, or is no such answer, is one sentence that names it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from napsp.errors import UserError, describe_failure

PARTS = ("observation", "achieved_goal", "desired_goal")


def tried(name: str, member: str, call: Callable[[], Any]) -> Any:
    """What a member of the environment ``name`` answers.

    Raises:
        UserError: it fails.
    """
    try:
        return call()
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{member} of {name} failed with {describe_failure(error)}; correct it") from error


def first_observation(env: Any, name: str, seed: int = 0) -> Any:
    """The observation after a reset.

    Raises:
        UserError: there is none.
    """
    try:
        inspect.signature(env.reset).bind(seed=seed, options=None)
    except TypeError as error:
        raise UserError(
            f"reset of {name} can not be called as Gymnasium does ({error}); let it take seed=None and options=None"
        ) from None
    answer = tried(name, f"reset(seed={seed}, options=None)", lambda: env.reset(seed=seed, options=None))
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise UserError(f"reset of {name} must return a tuple of observation and info, as Gymnasium's does")
    return answer[0]


def stepped(env: Any, name: str, action: np.ndarray) -> tuple[Any, Any, Any, Any, Any]:
    """Observation, reward, terminated, truncated and info after a step.

    Raises:
        UserError: they are not.
    """
    answer = tried(name, "step", lambda: env.step(action))
    if not isinstance(answer, tuple) or len(answer) != 5:
        raise UserError(
            f"step of {name} must return a tuple of observation, reward, terminated, truncated and info, as "
            "Gymnasium's does"
        )
    return answer


def check_observation(observation: Any, name: str, sizes: Mapping[str, int]) -> None:
    """Check that an observation has as many numbers in each part as the space says.

    Raises:
        UserError: it has not.
    """
    for part, size in sizes.items():
        found = observation.get(part) if isinstance(observation, dict) else None
        if not isinstance(found, np.ndarray) or found.shape != (size,) or not np.issubdtype(found.dtype, np.number):
            shown = f"{found.dtype} of shape {found.shape}" if isinstance(found, np.ndarray) else type(found).__name__
            raise UserError(f"{name} observes {part} as {shown}; give an array of {size} numbers as its space says")


def check_finite(observations: Mapping[str, np.ndarray], name: str) -> None:
    """Check that an environment observed finite numbers; one other would spoil every network that learns from it.

    Raises:
        UserError: it did not.
    """
    for part in PARTS:
        if not np.isfinite(observations[part]).all():
            raise UserError(f"{name} observed numbers that are not finite in {part}; correct its dynamics or its reset")
