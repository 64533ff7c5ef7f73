"""Does an environment offer what training needs? One sentence says what it lacks."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from napsp.envs.attempts import PARTS, check_finite, check_observation, first_observation, stepped
from napsp.envs.success import SuccessTest, check_sparse
from napsp.errors import UserError

N_GOALS, N_STEPS = 4, 5
N_SPACINGS = 50  # of float32 that a success has to be wide, at least: rounding then moves its edge by a hundredth


def check_spaces(env: Any, name: str) -> None:
    """Check that an environment observes flat numbers and acts by flat, bounded ones.

    Raises:
        UserError: it does not; the sentence names what is missing.
    """
    space, needed = env.observation_space, f"a Dict of flat Boxes: {', '.join(PARTS)}"
    if not isinstance(space, spaces.Dict):
        raise UserError(f"{name} observes a {type(space).__name__}; a goal environment observes {needed}")
    missing = [part for part in PARTS if part not in space.spaces]
    if missing:
        raise UserError(f"{name} does not observe {', '.join(missing)}; a goal environment observes {needed}")
    for part in PARTS:
        found = space[part]
        if not isinstance(found, spaces.Box):
            raise UserError(f"{name} observes {part} as a {type(found).__name__}; flatten it into one Box of numbers")
        if len(found.shape) != 1:
            kind = "an image" if len(found.shape) == 3 else "an array"
            raise UserError(
                f"{name} observes {part} as {kind} of shape {found.shape}; give a flat Box of numbers instead, which a "
                "wrapper can make of it"
            )
    if space["achieved_goal"].shape != space["desired_goal"].shape:
        raise UserError(f"achieved and desired goals of {name} have different sizes; make them alike")
    actions = env.action_space
    if not isinstance(actions, spaces.Box) or not np.issubdtype(actions.dtype, np.floating):
        raise UserError(f"the actions of {name} are {actions}; d and policy need continuous ones, a flat Box")
    if len(actions.shape) != 1 or not (np.isfinite(actions.low).all() and np.isfinite(actions.high).all()):
        raise UserError(f"the actions of {name} are {actions}; give a flat Box with finite bounds")


def check_behaviour(env: Any, name: str, test: SuccessTest, sparse: bool) -> None:
    """Try an environment. Resets and steps it: give one that is not needed any more.

    Args:
        env: with its wrappers; its spaces are right.
        name: for messages.
        test: its success test.
        sparse: whether that is its own reward.

    Raises:
        UserError: a member fails, or answers otherwise than Gymnasium asks; the sentence names it.
    """
    sizes = {part: env.observation_space[part].shape[0] for part in PARTS}
    starts = [first_observation(env, name, seed) for seed in range(N_GOALS)]
    for start in starts:
        check_observation(start, name, sizes)
        check_finite(start, name)
    achieved, actions = [start["achieved_goal"] for start in starts], env.action_space
    for share in np.linspace(0.1, 0.9, N_STEPS):
        action = (actions.low + share * (actions.high - actions.low)).astype(actions.dtype)
        observation, _, terminated, truncated, _ = stepped(env, name, action)
        check_observation(observation, name, sizes)
        achieved.append(observation["achieved_goal"])
        if terminated or truncated:
            break
    reached, desired = np.stack(achieved), np.stack([start["desired_goal"] for start in starts])
    pairs = np.repeat(reached, N_GOALS, axis=0), np.tile(desired, (len(reached), 1))
    together = test(*pairs)
    alone = [bool(test(pairs[0][i : i + 1], pairs[1][i : i + 1])[0]) for i in range(len(together))]
    if alone != together.tolist():
        raise UserError(f"the success test of {name} answers otherwise for many pairs than for one; correct it")
    if sparse:
        check_sparse(env, name, reached, desired)


def check_resolution(env: Any, name: str, start: dict[str, np.ndarray]) -> None:
    """Check that float32, in which episodes are kept and networks compute, can tell what is a success.

    Args:
        env: has ``reached`` for pairs of goals ``(n, G)``.
        name: for messages.
        start: an observation after a reset.

    Raises:
        UserError: its goals are too far from the origin for how close a success has to be, or not finite.
    """
    check_finite(start, name)
    goals = np.stack([start["achieved_goal"], start["desired_goal"]]).astype(np.float64)
    if (goals.astype(np.float32) == goals).all():  # whole numbers, say, of a test that may want no less than equality
        return
    step = np.spacing(np.abs(goals).max().astype(np.float32)).astype(np.float64)
    shifts = N_SPACINGS * step * np.vstack([np.eye(len(goals[1])), -np.eye(len(goals[1]))])
    near = goals[1] + shifts
    if not env.get_wrapper_attr("reached")(near, np.broadcast_to(goals[1], near.shape)).all():
        raise UserError(
            f"goals of {name} have coordinates of {np.abs(goals).max():.2g}, where float32 numbers are {step:.1g} "
            "apart: too coarse for its success test; let it observe positions relative to a point near its goals"
        )
