"""Does a task of the user's own keep what README's *Use your own environment* asks? One sentence says what it lacks."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np
from gymnasium.spaces import Box, Dict

from napsp.envs.dynamics import get_state
from napsp.errors import UserError, describe_failure

PARTS = ("observation", "achieved_goal", "desired_goal")


def check_task(env: Any, name: str) -> None:
    """Try every member of a task once, on a few rows.

    Warns if a step planned from a state differs from the step that the environment takes from there.

    Raises:
        UserError: a member fails, or answers in another shape or kind than documented; the sentence names it.
    """
    n_observation, n_actions, n_goal = _check_spaces(env, name)
    sizes = {"observation": n_observation, "achieved_goal": n_goal, "desired_goal": n_goal}
    observation = _tried(name, "reset(seed=0)", lambda: env.reset(seed=0)[0])
    _check_observation(observation, name, sizes)

    goals = np.stack([np.stack([observation["achieved_goal"], observation["desired_goal"]])] * 3)
    one = observation["desired_goal"]
    _check_answer(name, "reached", lambda: env.reached(goals, one), (3, 2), bool)
    _check_answer(name, "compute_reward", lambda: env.compute_reward(goals[0], goals[1], {}), (2,), float)
    _check_answer(name, "goal_positions", lambda: env.goal_positions(goals), (3, 2, 3), float)
    action = np.zeros(n_actions, np.float32)
    controls = _check_answer(name, "dynamics.control", lambda: env.dynamics.control(action[None]), (1, None), float)
    if env.dynamics.open_loop and controls.shape[1] != env.model.nu:
        raise UserError(
            f"dynamics.control of {name} returns {controls.shape[1]} numbers per action and the model has "
            f"{env.model.nu} actuators; with open_loop they must agree"
        )
    if isinstance(getattr(env, "camera", None), str):
        _tried(name, "camera", lambda: env.model.camera(env.camera))

    planned = _tried(name, "the simulation of dynamics.bind", lambda: _step_of_a_plan(env, controls))
    after = _tried(name, "step", lambda: env.step(action)[0])
    _check_observation(after, name, sizes)
    if not all(np.array_equal(after[part], found.astype(after[part].dtype)) for part, found in planned.items()):
        warnings.warn(
            f"{name}: a planned step differs from step() of the environment, so plans will not come true exactly; "
            "let both call the same dynamics",
            RuntimeWarning,
            stacklevel=2,
        )


def check_finite(observations: Mapping[str, np.ndarray], name: str) -> None:
    """Check that an environment observed finite numbers; one other would spoil every network that learns from it.

    Raises:
        UserError: it did not.
    """
    for part in PARTS:
        if not np.isfinite(observations[part]).all():
            raise UserError(f"{name} observed numbers that are not finite in {part}; correct its dynamics or its reset")


def _check_observation(observation: Any, name: str, sizes: dict[str, int]) -> None:
    for part, size in sizes.items():
        found = observation.get(part) if isinstance(observation, dict) else None
        if not isinstance(found, np.ndarray) or found.shape != (size,):
            shown = f"shape {found.shape}" if isinstance(found, np.ndarray) else type(found).__name__
            raise UserError(f"{name} observes {part} as {shown}; give an array of {size} numbers as its space says")
    check_finite(observation, name)


def _check_spaces(env: Any, name: str) -> tuple[int, int, int]:
    space, actions = env.observation_space, env.action_space
    if not isinstance(space, Dict) or not all(
        isinstance(space.spaces.get(part), Box) and len(space[part].shape or ()) == 1 for part in PARTS
    ):
        raise UserError(f"{name} must observe a Dict of three flat Box spaces: {', '.join(PARTS)}")
    if space["achieved_goal"].shape != space["desired_goal"].shape:
        raise UserError(f"achieved and desired goals of {name} have different sizes; make them alike")
    flat = isinstance(actions, Box) and len(actions.shape) == 1
    if not flat or (actions.low != -1).any() or (actions.high != 1).any():
        raise UserError(f"the actions of {name} must be a flat Box from -1 to 1; scale them in dynamics.control")
    return space["observation"].shape[0], actions.shape[0], space["desired_goal"].shape[0]  # type: ignore[index]


def _check_answer(
    name: str, member: str, call: Callable[[], Any], shape: tuple[int | None, ...], kind: type
) -> np.ndarray:
    found = np.asarray(_tried(name, member, call))
    fits = len(found.shape) == len(shape) and all(w in (None, n) for n, w in zip(found.shape, shape, strict=True))
    fits = fits and (found.dtype == bool if kind is bool else np.issubdtype(found.dtype, np.number))
    if not fits:
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise UserError(
            f"{member} of {name} returns {found.dtype} of shape {found.shape}; it must return {kind.__name__} of shape "
            f"({wanted}), see 'Use your own environment' in the README"
        )
    if kind is float and not np.isfinite(found).all():
        raise UserError(f"{member} of {name} returns numbers that are not finite; correct it")
    return found


def _step_of_a_plan(env: Any, controls: np.ndarray) -> dict[str, np.ndarray]:
    simulation, features = env.dynamics.bind(mujoco.MjData(env.model)), np.zeros((1, env.dynamics.n_features))
    simulation.restore(get_state(env.model, env.data))
    simulation.advance(controls, features)
    return dict(zip(PARTS, env.dynamics.observe(features[0]), strict=False))


def _tried(name: str, member: str, call: Callable[[], Any]) -> Any:
    try:
        return call()
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{member} of {name} failed with {describe_failure(error)}; correct it") from error
