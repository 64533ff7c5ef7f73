"""When is a goal reached? The task's sparse reward says so, or a test that the user names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from napsp.errors import UserError, describe_failure, load_object

SuccessTest = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Maps achieved and desired goals, both ``(n, G)``, to bool ``(n,)``."""

FAR = (0.3, -0.3, 1.7, -1.7, 31.0, -31.0, 1000.0, -1000.0)  # goals may be angles, so no multiples of one another
SAME = 1e-6  # rewards that differ by less are one
HOW_TO_NAME_ONE = (
    "name a success test: --reached RADIUS, or --reached module:function of achieved and desired goals (n, G)"
)


def success_test(env: Any, name: str, reached: str | None) -> SuccessTest:
    """The success test of an environment.

    Args:
        env: with its wrappers.
        name: its name, for messages.
        reached: a radius in units of the goal, ``module:function``, or None for the environment's own sparse reward.

    Raises:
        UserError: there is none, or it is no radius; when called: it fails, or answers in another shape.
    """
    if reached is None:
        if not env.has_wrapper_attr("compute_reward"):
            raise UserError(f"{name} has no compute_reward(achieved_goal, desired_goal, info); {HOW_TO_NAME_ONE}")
        return _checked(_at_best_reward(env.get_wrapper_attr("compute_reward")), f"compute_reward of {name}")
    if ":" in reached:
        return _checked(load_object(reached), f"--reached {reached}")
    radius = radius_of(reached)
    return lambda achieved, desired: np.linalg.norm(achieved - desired, axis=-1) < radius


def radius_of(reached: str | None) -> float | None:
    """The radius that a success test is named by; None where it is named otherwise.

    Raises:
        UserError: it is no positive number.
    """
    if reached is None or ":" in reached:
        return None
    try:
        radius = float(reached)
    except ValueError:
        radius = np.nan
    if not 0 < radius < np.inf:
        raise UserError(f"--reached is {reached}; give a positive radius, or module:function")
    return radius


def _at_best_reward(compute_reward: Callable[..., Any]) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Reached is what is rewarded as being exactly there is: 0 of 0 and -1, 1 of 1 and 0."""

    def reached(achieved: np.ndarray, desired: np.ndarray) -> np.ndarray:
        found, best = (np.asarray(compute_reward(goals, desired, {}), np.float64) for goals in (achieved, desired))
        return found >= best - SAME

    return reached


def _checked(test: Callable[[np.ndarray, np.ndarray], Any], named: str) -> SuccessTest:
    def reached(achieved: np.ndarray, desired: np.ndarray) -> np.ndarray:
        try:
            found = np.asarray(test(achieved, desired))
        except UserError:
            raise
        except Exception as error:
            raise UserError(
                f"{named} failed for {len(achieved)} pairs of goals at once with {describe_failure(error)}; let it "
                f"take arrays (n, G), or {HOW_TO_NAME_ONE}"
            ) from error
        if found.shape != (len(achieved),):
            raise UserError(
                f"{named} returned shape {found.shape} for {len(achieved)} pairs of goals; let it return one answer "
                f"per pair, or {HOW_TO_NAME_ONE}"
            )
        return found.astype(bool)

    return reached


def check_sparse(env: Any, name: str, achieved: np.ndarray, desired: np.ndarray) -> None:
    """Check that the reward of an environment tells success from failure and nothing else.

    Args:
        env: with its wrappers.
        name: its name, for messages.
        achieved: goals that were achieved, ``(n, G)``.
        desired: goals that were desired, ``(m, G)``.

    Raises:
        UserError: it is dense, or tells nothing apart.
    """
    compute_reward = env.get_wrapper_attr("compute_reward")
    there = np.asarray(compute_reward(desired, desired, {}), np.float64)
    pairs = np.repeat(achieved, len(desired), axis=0), np.tile(desired, (len(achieved), 1))
    found = np.asarray(compute_reward(*pairs, {}), np.float64)
    values = np.unique(np.round(np.concatenate([there, found]), 6))
    if len(values) > 2 or np.ptp(there) > SAME:
        shown = ", ".join(f"{value:g}" for value in values[:4])
        raise UserError(f"compute_reward of {name} is dense (it gives {shown} and so on); {HOW_TO_NAME_ONE}")
    if len(values) == 1 and _is_constant(compute_reward, desired, values[0]):
        raise UserError(f"compute_reward of {name} gives {values[0]:g} wherever one is; {HOW_TO_NAME_ONE}")
    if len(values) == 2 and there[0] < values[1] - SAME:
        raise UserError(f"compute_reward of {name} gives {there[0]:g} at a goal and more elsewhere; {HOW_TO_NAME_ONE}")


def _is_constant(compute_reward: Callable[..., Any], desired: np.ndarray, value: float) -> bool:
    """Whether a reward stays what it is at the goals ``(m, G)`` when one is ever farther from them, up to 1000 times.

    A reward that fails so far away tells something apart.
    """
    far = np.concatenate([desired + way * (1.0 + np.abs(desired)) for way in FAR])
    try:
        found = np.asarray(compute_reward(far.astype(desired.dtype), np.tile(desired, (len(FAR), 1)), {}), np.float64)
    except Exception:  # the user's own; it was tried where it has to work
        return False
    return bool((np.abs(found - value) <= SAME).all())
