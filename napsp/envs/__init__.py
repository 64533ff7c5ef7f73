"""The tasks: short names, Gymnasium registration and :func:`make`."""

from __future__ import annotations

from functools import partial
from numbers import Real
from typing import Any

import farama_notifications

# gymnasium-robotics prints a notice about its Adroit tasks on import; no task here is one.
farama_notifications.notifications.pop("gymnasium_robotics", None)

from napsp.opengl import import_mujoco  # noqa: E402

import_mujoco()  # before anything else does

import gymnasium  # noqa: E402

from napsp.envs.cards import CARDS  # noqa: E402
from napsp.envs.wrappers import unwrapped  # noqa: E402
from napsp.errors import UserError, choose, close, load_module, load_object  # noqa: E402

DEFAULT_EPISODE_LENGTH = 50  # of a class given as module:Class that names none
NAMES = {name: task for task, card in CARDS.items() for name in (card.gym_id, *card.aliases)}
STOCK_WORDS = ("Fetch", "Hand", "Maze")  # ids with one of them are gymnasium-robotics'


def canonical_name(name: str) -> str:
    """Resolve an alias or a Gymnasium id to a task name.

    Other registered ids (``FetchPush-v4``, or ``my_package:user/Task-v0`` where a package has to be imported first, as
    for ``gymnasium.make``) and classes (``my_module:MyEnv``) name themselves.

    Raises:
        UserError: the name is unknown; the message lists the known ones.
    """
    name = NAMES.get(name, name)
    if name in CARDS:
        return name
    if ":" in name:
        gym_id = _registered(name)
        return NAMES.get(gym_id, name) if gym_id else name
    stock = any(word in name for word in STOCK_WORDS)
    if stock:
        import gymnasium_robotics

        gymnasium.register_envs(gymnasium_robotics)
    if name in gymnasium.registry:
        return name
    known = [*CARDS, *(alias for card in CARDS.values() for alias in card.aliases)]
    others = ", a registered Gymnasium id, package:Id where a package registers it, or your own module:Class"
    meant = close(name, [*known, *(gymnasium.registry if stock else ())])
    hint = f"did you mean {meant}? napsp list shows what ships" if meant else choose(name, known, others)
    raise UserError(f"unknown environment {name!r}; {hint}")


def _registered(name: str) -> str | None:
    """The id that ``package:Id`` names, once the package is imported; None for ``module:Class`` and for a bare id.

    Raises:
        UserError: there is neither.
    """
    package, colon, attribute = name.partition(":")
    if not colon:
        return None
    if attribute not in vars(load_module(package, name)) and attribute in gymnasium.registry:
        return attribute
    load_object(name)
    return None


def episode_length(name: str) -> int:
    """Control steps per episode of a task.

    Raises:
        UserError: the task has no time limit.
    """
    name = canonical_name(name)
    if name in CARDS:
        return CARDS[name].episode_length
    gym_id = _registered(name) or name
    if ":" in gym_id:
        steps = getattr(load_object(name), "max_episode_steps", DEFAULT_EPISODE_LENGTH)
        number = float(steps) if isinstance(steps, Real) else 0.0
        if not number.is_integer() or number < 1:
            raise UserError(f"max_episode_steps of {name} is {steps!r}; give a whole number of at least 1")
        return int(number)
    steps = gymnasium.spec(gym_id).max_episode_steps
    if steps is None:
        raise UserError(f"{name} has no time limit; register it with max_episode_steps")
    return steps


def create(name: str, **kwargs: Any) -> gymnasium.Env:
    """Create an environment as its class or registration makes it, wrappers included.

    Raises:
        UserError: unknown, or no environment.
    """
    from napsp.envs.joint_types import mend_joint_types  # gymnasium-robotics takes a while to import

    name = canonical_name(name)
    mend_joint_types()
    try:
        env: Any = _loader(name)(**kwargs)
    except Exception as error:
        raise UserError(f"{name} could not be created ({error}); check it with gymnasium.make first") from error
    if not isinstance(env, gymnasium.Env):
        raise UserError(f"{name} is no gymnasium.Env; derive it from gymnasium_robotics.core.GoalEnv")
    return env


def _loader(name: str) -> Any:
    """What makes the environment of a canonical name."""
    gym_id = CARDS[name].gym_id if name in CARDS else _registered(name) or name
    if ":" in gym_id:
        return load_object(name)
    return partial(gymnasium.make, gym_id, disable_env_checker=True)  # what we need is checked here, in one sentence


def make(name: str, reached: str | None = None, **kwargs: Any) -> gymnasium.Env:
    """Create a task to plan in, with its time limit.

    Args:
        name: of a task, a Gymnasium id, ``package:id`` or ``module:Class``.
        reached: success test of an environment that saves its state and whose rewards are dense.
        kwargs: of the environment's class.

    Raises:
        UserError: unknown, or an environment that cannot be planned in, because of its wrappers say.
    """
    name = canonical_name(name)
    if name in CARDS:
        refuse_test(name, reached)
        return gymnasium.make(CARDS[name].gym_id, **kwargs)
    own = {option: value for option, value in kwargs.items() if option != "render_mode"}
    load = partial(_loader(name), **own)  # others of its kind, that are not looked at
    env: Any = create(name, **kwargs)
    missing = lacks(env.unwrapped)
    if missing and plans_by_state(env):
        from napsp.envs.saved_task import saved_task

        env = saved_task(name, unwrapped(name, env, lookers=True), reached, lambda: load().unwrapped)
        return gymnasium.wrappers.TimeLimit(env, episode_length(name))
    refuse_test(name, reached)
    if missing:
        env.close()
        unwrapped(name, env, lookers=False)
        for option in sorted({"reward_type", "max_episode_steps"} & own.keys()):
            raise UserError(f"{name} has rewards of 0 and -1 and its own episode length here; leave out {option}")
        env = _adapt(name, env.unwrapped, load, missing, kwargs.get("render_mode"))
    else:
        env = unwrapped(name, env, lookers=True)
        if (name, repr(own)) not in _CHECKED:
            from napsp.envs.check import check_task

            tried = load()  # another one, so that the environment handed out begins as its class made it
            try:
                check_task(tried.unwrapped, name)
            finally:
                tried.close()
            _CHECKED.add((name, repr(own)))  # once per process: it takes a reset, and training makes several
    return gymnasium.wrappers.TimeLimit(env, episode_length(name))


_CHECKED: set[tuple[str, str]] = set()
REQUIRED = ("dynamics", "model", "data", "reached", "compute_reward", "goal_positions", "goal_radius", "step_length")


def lacks(world: Any) -> list[str]:
    """What planning asks of an environment (unwrapped) and it does not have; properties are not asked for a value."""
    return [member for member in REQUIRED if not (hasattr(type(world), member) or hasattr(world, member))]


def plans_by_state(env: gymnasium.Env) -> bool:
    """Whether planning simulates an environment by saving and restoring its state, for want of dynamics."""
    from napsp.envs.saved import saves_state
    from napsp.envs.stock import FAMILIES  # gymnasium-robotics takes a while to import

    world = env.unwrapped
    stock = isinstance(world, tuple(kind for kind, _ in FAMILIES))
    return saves_state(world) and bool(lacks(world)) and not stock


def refuse_test(name: str, reached: str | None) -> None:
    """Refuse another success test for a task that has its own.

    Raises:
        UserError: one is named.
    """
    if reached is not None:
        raise UserError(f"{name} has a success test of its own; leave out --reached")


def _adapt(name: str, world: Any, load: Any, missing: list[str], render_mode: str | None) -> gymnasium.Env:
    """Make a stock robot or maze a task; others have to offer their dynamics or their state themselves."""
    from napsp.envs.adapter import StockTask
    from napsp.envs.saved import PROTOCOL

    lacking = [method for method in PROTOCOL if not callable(getattr(world, method, None))]
    try:
        task = StockTask(lambda **options: load(**options).unwrapped, render_mode)
        task.task_name = name
        return task
    except TypeError:
        raise UserError(
            f"{name} can not be planned in: it lacks {', '.join(missing)} and is neither a "
            "MujocoRobotEnv nor a MazeEnv of gymnasium-robotics; planners simulate a task by the dynamics of its "
            "MuJoCo model, so add them as docs/environments.md shows, or by saving and restoring its state, so add "
            f"{' and '.join(lacking)} as docs/goal_environments.md shows (training needs none of it)"
        ) from None


def file_name(name: str) -> str:
    """A task's name for use in file names."""
    return canonical_name(name).replace("/", "-").replace(":", "-")


def register_all() -> None:
    """Register every task with Gymnasium (done once, on import)."""
    for card in CARDS.values():
        if card.gym_id not in gymnasium.registry:
            gymnasium.register(
                card.gym_id, card.entry_point, max_episode_steps=card.episode_length, kwargs=dict(card.kwargs)
            )


register_all()
