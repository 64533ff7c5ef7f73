"""Does a task of the user's own keep what docs/environments.md asks? One sentence says what it lacks."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from numbers import Real
from typing import Any

import mujoco
import numpy as np
from gymnasium.spaces import Box, Dict

from napsp.envs.attempts import PARTS, check_finite, check_observation, first_observation, stepped, tried
from napsp.envs.dynamics import get_state
from napsp.errors import UserError

DYNAMICS = ("model", "substeps", "n_features", "open_loop", "bind", "control", "observe")


def check_task(env: Any, name: str) -> None:
    """Try the members of a task, in batches and alone. Resets and steps ``env``: give one that is not needed any more.

    Warns if steps planned from a state differ from those that the environment takes from there.

    Raises:
        UserError: a member fails, or answers in another shape or kind than documented; the sentence names it.
    """
    n_observation, n_goal = _check_spaces(env, name)
    missing = [member for member in DYNAMICS if not hasattr(env.dynamics, member)]
    if missing:
        raise UserError(f"the dynamics of {name} lack {', '.join(missing)}; see napsp/envs/dynamics.py")
    for member in ("goal_radius", "step_length"):
        value = getattr(env, member)
        if not isinstance(value, Real) or not 0 < float(value) < np.inf:
            raise UserError(f"{member} of {name} is {value!r}; give a positive number")
    if isinstance(getattr(env, "camera", None), str):
        tried(name, "camera", lambda: env.model.camera(env.camera))

    sizes = {"observation": n_observation, "achieved_goal": n_goal, "desired_goal": n_goal}
    start = first_observation(env, name)
    check_observation(start, name, sizes)
    check_finite(start, name)
    _check_goals(env, name, start)
    _check_dynamics(env, name, sizes)


def _check_goals(env: Any, name: str, start: dict[str, np.ndarray]) -> None:
    achieved = np.stack([np.stack([start["achieved_goal"], start["desired_goal"]])] * 3)
    desired = np.broadcast_to(start["desired_goal"], achieved.shape)
    reached = _check_answer(name, "reached", lambda: env.reached(achieved, desired), (3, 2), bool)
    rewards = _check_answer(
        name, "compute_reward", lambda: env.compute_reward(achieved[0], desired[0], {}), (2,), float
    )
    if not np.array_equal(rewards, reached[0] - 1.0):
        raise UserError(f"compute_reward of {name} must be 0 where reached and -1 elsewhere, not {rewards}")
    _check_answer(name, "goal_positions", lambda: env.goal_positions(achieved), (3, 2, 3), float)


def _check_dynamics(env: Any, name: str, sizes: dict[str, int]) -> None:
    dynamics, n_actions = env.dynamics, env.action_space.shape[0]
    actions = np.linspace(-0.7, 0.9, 2 * n_actions, dtype=np.float32).reshape(2, n_actions)  # two steps, none alike
    batch = np.stack([actions[::-1], actions, 0.5 * actions])
    controls = _check_answer(name, "dynamics.control", lambda: dynamics.control(batch), (3, 2, None), float)
    if dynamics.open_loop and controls.shape[2] != env.model.nu:
        raise UserError(
            f"dynamics.control of {name} returns {controls.shape[2]} numbers per action and the model has "
            f"{env.model.nu} actuators; with open_loop they must agree"
        )
    alone = tried(name, "dynamics.control", lambda: dynamics.control(actions[:1]))
    if not np.array_equal(alone[0], controls[1, 0]):
        raise UserError(f"dynamics.control of {name} depends on what else is in the batch; use element-wise arithmetic")

    features = tried(name, "the simulation of dynamics.bind", lambda: _planned(env, controls[1]))
    pair = tried(name, "dynamics.observe", lambda: dynamics.observe(np.stack([features, features[::-1]])))
    if not isinstance(pair, tuple) or len(pair) != 2:
        raise UserError(f"dynamics.observe of {name} must return a tuple of observation and achieved goal")
    single = tried(name, "dynamics.observe", lambda: dynamics.observe(features[1]))
    for part, found, one in zip(PARTS, pair, single, strict=False):
        _check_answer(name, f"dynamics.observe ({part})", lambda found=found: found, (2, 2, sizes[part]), float)
        if not np.array_equal(found[1, 0], one):
            raise UserError(
                f"dynamics.observe of {name} depends on what else is in the batch; use element-wise arithmetic"
            )

    before, kept = {}, {}
    for step, action in enumerate(actions):
        after, _, terminated, truncated, _ = stepped(env, name, action)
        check_observation(after, name, sizes)
        check_finite(after, name)
        if any(not np.array_equal(before[part], kept[part]) for part in kept):
            warnings.warn(
                f"{name}: a step overwrites the observation of the one before; return copies (a slice of features is a "
                "view)",
                RuntimeWarning,
                stacklevel=3,
            )
        before, kept = after, {part: after[part].copy() for part in PARTS}
        planned = dict(zip(PARTS, (found[0, step] for found in pair), strict=False))
        if not all(np.array_equal(after[part], found.astype(after[part].dtype)) for part, found in planned.items()):
            warnings.warn(
                f"{name}: a planned step differs from step() of the environment, so plans will not come true exactly; "
                "let both call the same dynamics",
                RuntimeWarning,
                stacklevel=3,
            )
            return
        if terminated or truncated:
            return


def _check_spaces(env: Any, name: str) -> tuple[int, int]:
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
    return space["observation"].shape[0], space["desired_goal"].shape[0]  # type: ignore[index]


def _check_answer(
    name: str, member: str, call: Callable[[], Any], shape: tuple[int | None, ...], kind: type
) -> np.ndarray:
    found = np.asarray(tried(name, member, call))
    fits = len(found.shape) == len(shape) and all(w in (None, n) for n, w in zip(found.shape, shape, strict=True))
    fits = fits and (found.dtype == bool if kind is bool else np.issubdtype(found.dtype, np.number))
    if not fits:
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise UserError(
            f"{member} of {name} returns {found.dtype} of shape {found.shape}; it must return {kind.__name__} of shape "
            f"({wanted}), see docs/environments.md"
        )
    if kind is float and not np.isfinite(found).all():
        raise UserError(f"{member} of {name} returns numbers that are not finite; correct it")
    return found


def _planned(env: Any, controls: np.ndarray) -> np.ndarray:
    simulation = env.dynamics.bind(mujoco.MjData(env.model))
    features = np.full((len(controls), env.dynamics.n_features), np.nan)
    simulation.restore(get_state(env.model, env.data))
    simulation.advance(controls, features)
    return features
