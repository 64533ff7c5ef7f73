"""A controller from its configuration: physics, cost, search, proposals and smoothing put together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mpc.controller import Controller
from mpc.cost import Cost, StepsToGo
from mpc.rollout import RolloutEngine
from mpc.workers import CAN_FORK
from napsp.storage.checkpoint import Model
from planners.app.config import PlanConfig
from planners.app.estimates import steps_to_go
from planners.app.options import RunOptions
from planners.app.searches import SEARCHES
from planners.app.world import Planned, check_goal, proposers, smoother


def build_controller(
    config: PlanConfig[Any],
    run: RunOptions,
    models: Sequence[Model],
    world: Any,
    fork: bool = CAN_FORK,
    estimate: StepsToGo | None = None,
) -> Controller:
    """What plans in ``world``.

    Args:
        config: how plans are made, with the task's values.
        run: its seed and threads count.
        models: the one to plan with, then those of the ensemble; none for a cost that needs no distance.
        world: the unwrapped environment.
        fork: let forked processes simulate.
        estimate: steps to go in place of those that ``config.cost`` names.

    Raises:
        UserError: models, goal or cost do not fit the task.
    """
    model = models[0] if models else None
    if model is not None:
        model.check_sizes(world)
    check_goal(config.goal, world)
    horizon, n_actions = config.horizon or config.usual.horizon, world.action_space.shape[0]
    cost = Cost(estimate or steps_to_go(config, models, world), world.reached, config.where, config.action_of)
    planned = Planned(config, world)
    engine = RolloutEngine(planned(), run.threads, fork, source=planned)
    search: Any = config.search
    return Controller(
        engine,
        SEARCHES[config.planner].kind(config.spline.knots or horizon, n_actions, search),
        cost,
        horizon,
        np.random.default_rng(run.seed),
        config.spline,
        search.refinements,
        proposers(config, model, n_actions),
        smoother(config, engine, cost, model, horizon, n_actions),
    )
