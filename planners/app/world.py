"""What a session plans in and with, built from its configuration: the physics, who proposes plans, who smooths them."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpc.controller import Smoother
from mpc.cost import Cost
from mpc.filters import LowPass
from mpc.rollout import Actor, RolloutEngine
from napsp.envs.coarse import coarse
from napsp.envs.dynamics import Dynamics
from napsp.envs.lean import lean
from napsp.errors import UserError
from napsp.policy.greedy import GreedyPolicy
from napsp.policy.greedy_distance import GreedyDistance
from napsp.storage.checkpoint import Model
from planners.app.config import PlanConfig


def check_goal(goal: tuple[float, ...] | None, world: Any) -> None:
    """Check a goal of the user's own.

    Raises:
        UserError: the task's goals have another size, or a number is not finite.
    """
    size = world.observation_space["desired_goal"].shape[0]
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
