"""What a session plans in and with, built from its configuration: the physics, who proposes plans, who smooths them."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpc.controller import Smoother
from mpc.cost import Cost
from mpc.filters import LowPass
from mpc.rollout import Actor, RolloutEngine
from mpc.verify import Verified, verify
from napsp import envs as tasks
from napsp.envs.coarse import coarse
from napsp.envs.dynamics import Dynamics
from napsp.envs.lean import lean, refresh, still_serves
from napsp.envs.watch import watched
from napsp.errors import UserError, describe_failure
from napsp.policy.greedy import GreedyPolicy
from napsp.policy.greedy_distance import GreedyDistance
from napsp.storage.checkpoint import Model
from planners.app.config import PlanConfig
from planners.app.options import RunOptions


def check_goal(goal: tuple[float, ...] | None, world: Any) -> None:
    """Check a goal of the user's own.

    Raises:
        UserError: the task's goals have another size, a number is not finite, or its goal can not be set.
    """
    size = world.observation_space["desired_goal"].shape[0]
    if goal is not None and not hasattr(world, "goal"):
        raise UserError(
            f"--goal sets the attribute goal, which {type(world).__name__} lacks; let it keep its goal there"
        )
    if goal is not None and (len(goal) != size or not np.isfinite(goal).all()):
        raise UserError(f"--goal {' '.join(map(str, goal))} does not fit; give {size} finite numbers")


def planned_dynamics(config: PlanConfig[Any], world: Any) -> Dynamics:
    """The physics to plan in: the environment's own, less decoration, unless coarse ones are asked for.

    Raises:
        UserError: the environment has no physics steps to leave out, or fewer than are asked for.
    """
    own, spec, model = world.dynamics.substeps, getattr(world, "model_spec", None), config.model
    dynamics = lean(world.dynamics, spec, world.action_space.shape[0])
    if model.kind == "exact":
        return dynamics
    if own == 1:
        raise UserError(
            f"{config.env} has one physics step per control step, none to leave out; plan in the exact model"
        )
    if (model.substeps or 1) > own:
        raise UserError(f"--model.substeps {model.substeps} exceeds the {own} of {config.env}; use fewer")
    usual = min(own, config.usual.coarse_substeps or max(1, own // 4))
    return coarse(dynamics, model.substeps or usual)


class Planned:
    """Answers which dynamics to plan in now: the environment's as it is, or a copy that keeps up with it."""

    def __init__(self, config: PlanConfig[Any], world: Any) -> None:
        self._config, self._world = config, world
        self._make()

    def _make(self) -> None:
        world = self._world
        self._own, self._model = world.dynamics, world.model
        self._dynamics = planned_dynamics(self._config, world)
        self._watched = watched(self._own)

    def __call__(self) -> Dynamics:
        """The dynamics to plan in."""
        world = self._world
        if world.dynamics is not self._own or world.model is not self._model:
            self._make()
        elif self._dynamics is not self._own:
            numbers, attributes = (part.changed() for part in self._watched)
            if attributes or (numbers and not still_serves(self._dynamics)):
                self._make()
            elif numbers:
                refresh(self._dynamics)
        return self._dynamics


def verify_task(config: PlanConfig[Any], run: RunOptions, reached: str | None = None) -> Verified:
    """Try on another environment of the same kind whether plans of a session would come true.

    Args:
        config: how plans are made, with the task's values.
        run: its threads count.
        reached: the success test of the session.

    Raises:
        UserError: the environment fails; the sentence says where.
    """
    env = tasks.make(config.env, reached)
    planned = Planned(config, env.unwrapped)
    try:
        with RolloutEngine(planned(), run.threads, source=planned) as engine:
            return verify(env, engine, config.env)
    except UserError:
        raise
    except Exception as error:
        raise UserError(
            f"{config.env} failed while it was tried, with {describe_failure(error)}; correct it"
        ) from error
    finally:
        env.close()


def proposers(config: PlanConfig[Any], model: Model | None, n_actions: int) -> list[Actor]:
    """Whose own rollouts join the samples."""
    actors: list[Actor] = []
    if model is not None and config.proposals:
        actors.append(GreedyPolicy(model.policy))
    if config.distance.greedy_proposals and model is not None and model.distance is not None:
        actors.append(GreedyDistance(model.distance, n_actions))
    return actors


def smoother(
    config: PlanConfig[Any], engine: RolloutEngine, cost: Cost, model: Model | None, horizon: int, n_actions: int
) -> Smoother | None:
    """What smooths the plans; ``config`` has its task's values."""
    if config.low_pass:
        return LowPass(config.low_pass)
    if config.smooth is None or model is None:
        return None
    from mpc.smoothing import layer  # imports casadi, which nobody else needs

    return layer.Smoother(engine, cost, model, horizon, n_actions, config.smooth)
