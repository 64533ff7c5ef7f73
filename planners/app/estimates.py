"""What a plan is charged for its steps to go, built from the configuration: models and their estimate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mpc.cost import EuclideanSteps, GivenSteps, LearnedSteps, NoSteps, StepsToGo
from napsp.errors import UserError, describe_failure, load_object
from napsp.storage.checkpoint import Model, load_model
from napsp.storage.shipped import shipped_model
from planners.app.config import PlanConfig


def load_models(config: PlanConfig[Any], checkpoint: Path | None, given: Model | None = None) -> list[Model]:
    """The checkpoint to plan with, then those of the ensemble; none for a cost that needs no distance.

    Args:
        config: how plans are made, with the task's one name.
        checkpoint: None is the one that ships for the task.
        given: a model in place of the checkpoint's.

    Raises:
        UserError: a checkpoint is unusable, of another task, or lacks what the options ask of it.
    """
    if config.cost != "distance":
        return []
    env_name = config.env
    if given is not None and given.config.env != env_name:
        raise UserError(f"this distance was trained on {given.config.env}, not on {env_name}; load one of {env_name}")
    model = given or load_model(checkpoint or shipped_model(env_name), env_name)
    if model.distance is None:
        raise UserError("this checkpoint holds no distance (method sparse); use --cost sparse or another one")
    if config.distance.pessimism and model.visits is None:
        raise UserError(
            f"--distance.pessimism needs visit counts and this checkpoint holds none; train one with: "
            f"python -m napsp.train --env {env_name}, then pass it with --checkpoint, or use --distance.ensemble"
        )
    if config.smooth and not model.distance.plain():
        raise UserError("--smooth needs a distance of plain networks (--distance.head mlp); plan without it")
    ensemble = [load_model(path, env_name) for path in config.distance.ensemble]
    for path, member in zip(config.distance.ensemble, ensemble, strict=True):
        if member.distance is None:
            raise UserError(f"{path} of --distance.ensemble holds no distance (method sparse); leave it out")
        if member.header["sizes"] != model.header["sizes"]:
            raise UserError(
                f"{path} of --distance.ensemble was trained on another version of {env_name}; train it again"
            )
    return [model, *ensemble]


def success_test_of(config: PlanConfig[Any], models: Sequence[Model]) -> str | None:
    """The success test that is asked for, or else that of the training; None is the task's own."""
    return config.reached or (models[0].config.reached if models else None)


def steps_to_go(config: PlanConfig[Any], models: Sequence[Model], world: Any) -> StepsToGo:
    """The estimate that ``--cost`` names.

    Raises:
        UserError: it is not known for this task.
    """
    if models:
        return LearnedSteps(models[0], config.distance.pessimism, models[1:])
    if config.cost == "shortest_path":
        if not hasattr(world, "shortest_steps"):
            raise UserError(f"the true shortest path of {config.env} is not known; use --cost euclidean or distance")
        return GivenSteps(world.shortest_steps)
    if ":" in config.cost:
        return GivenSteps(own_cost(config.cost))
    return EuclideanSteps(world.step_length) if config.cost == "euclidean" else NoSteps()


def own_cost(name: str) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The user's cost ``module:function``; what goes wrong in it is said in one sentence.

    Raises:
        UserError: there is no such function; when called: it raises, or returns another shape than ``(B,)``.
    """
    function = load_object(name)

    def steps(achieved_goals: np.ndarray, goal: np.ndarray) -> np.ndarray:
        try:
            found = function(achieved_goals, goal)
        except Exception as error:
            raise UserError(f"--cost {name} failed with {describe_failure(error)}; correct the function") from error
        try:
            found = np.asarray(found, np.float64)
        except (TypeError, ValueError):
            raise UserError(f"--cost {name} returned {type(found).__name__}; return one number per goal") from None
        if found.shape != achieved_goals.shape[:1]:
            raise UserError(
                f"--cost {name} returned shape {found.shape} for {len(achieved_goals)} goals; return a number per goal"
            )
        return found

    return steps
