"""Planning from the user's own loop: ``planners.controller("mppi", env, cost=d)``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any

import gymnasium
import numpy as np

from mpc.controller import Controller, Plan
from mpc.cost import GivenSteps
from napsp import envs as tasks
from napsp.envs.wrappers import LOOKERS, STANDARD, wrappers_around
from napsp.errors import UserError, choose
from napsp.library import Distance
from planners.app.build import build_controller
from planners.app.config import PlanConfig
from planners.app.estimates import load_models
from planners.app.options import RunOptions
from planners.app.searches import SEARCHES

Cost = Distance | str | Callable[[np.ndarray, np.ndarray], np.ndarray]


class TaskController:
    """Plans in an environment, from the state that it is in when it is asked.

    Attributes:
        env: it is only read.
        controller: the receding-horizon loop; its ``engine`` holds threads or processes until :meth:`close`.
    """

    def __init__(self, env: gymnasium.Env, controller: Controller) -> None:
        self.env, self.controller = env, controller

    def plan(self, observation: dict[str, np.ndarray]) -> Plan:
        """Plan from the environment's current state; ``action`` of the answer is the one to take now.

        Each call is a control step: the plan is moved on by one action from the last call.

        Args:
            observation: the last one of the environment.
        """
        return self.controller.plan(self.env.unwrapped, observation)

    def reset(self, seed: int | None = None) -> None:
        """Forget the plan, for a new episode; draw from ``seed`` from here on, if one is given."""
        self.controller.reset(None if seed is None else np.random.default_rng(seed))

    def close(self) -> None:
        """Stop threads and processes."""
        self.controller.engine.close()

    def __enter__(self) -> TaskController:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def controller(
    search: str,
    env: gymnasium.Env,
    *,
    cost: Cost = "distance",
    samples: int | None = None,
    horizon: int | None = None,
    seed: int = 0,
    threads: int | None = None,
    options: Mapping[str, Any] | None = None,
) -> TaskController:
    """A controller for an environment, made as the planning commands make theirs.

    Args:
        search: mppi, cem, icem, predictive_sampling or smooth.
        env: of :func:`napsp.make`, or one that has what docs/environments.md asks for.
        cost: steps to go: a :class:`napsp.Distance`; ``"distance"`` (the one that ships for the task), ``"euclidean"``,
            ``"sparse"`` or ``"shortest_path"``; or a function of achieved goals ``(B, G)`` and a goal ``(G,)``.
        samples: N, plans per refinement.
        horizon: H, control steps per plan.
        seed: of planning.
        threads: simulations at once; all cores if None. Plans do not depend on it.
        options: any other option of the commands by its dotted name, such as ``{"search.temperature": 0.1}``.

    Raises:
        UserError: an option is unknown or out of its range, or the environment or cost can not be planned with.
    """
    if search not in SEARCHES:
        raise UserError(f"there is no search {search!r}; {choose(search, SEARCHES)}")
    world: Any = env.unwrapped
    missing = tasks.lacks(world)
    if missing and tasks.plans_by_state(env):
        raise UserError(f"{type(world).__name__} is planned in by its own state as what napsp.make makes of it; hand "
                        "that over, with no wrapper around it that changes anything")  # fmt: skip
    if missing:
        raise UserError(f"{type(world).__name__} can not be planned in: it lacks {', '.join(missing)}, see "
                        "docs/environments.md")  # fmt: skip
    around = [wrapper for wrapper in wrappers_around(env) if not isinstance(wrapper, (*STANDARD, *LOOKERS))]
    own = [type(wrapper).__name__ for wrapper in around]
    if own:
        raise UserError(f"the environment is wrapped in {', '.join(own)}, which plans would not pass through; plan in "
                        "it without them")  # fmt: skip
    if "goal" in (options or {}):
        raise UserError("a controller plans to the goal of the observation that it is handed; change that one instead")
    given = {"planner", "env"} | (set() if cost == "distance" else {"cost"})
    for name in sorted(given & set(options or {})):
        raise UserError(f"{name} is no option of a controller; hand it over as an argument")
    named = "distance" if isinstance(cost, Distance) else cost if isinstance(cost, str) else _named(cost)
    changes = {"env": _name(env), "cost": named, "horizon": horizon, **(options or {})}
    changes |= {} if samples is None else {"search.samples": samples}
    config = PlanConfig.of(search, changes).resolved()
    models = load_models(config, None, cost.model if isinstance(cost, Distance) else None)
    estimate = None if isinstance(cost, Distance | str) else GivenSteps(cost)
    run = RunOptions(seed=seed, threads=threads)
    return TaskController(env, build_controller(config, run, models, world, estimate=estimate))


def _named(cost: Callable[..., Any]) -> str:
    """A function as ``--cost`` would name it."""
    kind = cost if hasattr(cost, "__qualname__") else type(cost)
    return f"{kind.__module__}:{kind.__qualname__}"


def _name(env: gymnasium.Env) -> str:
    """The task's name, which tells its defaults; of classes that nobody registered, ``module:Class``."""
    if getattr(env.unwrapped, "task_name", None):
        return env.unwrapped.task_name  # type: ignore[attr-defined]
    if env.spec is not None:
        return tasks.canonical_name(env.spec.id)
    kind = type(env.unwrapped)
    return f"{kind.__module__}:{kind.__qualname__}"
