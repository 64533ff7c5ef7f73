"""What a plan is charged for its steps to go, built from the options: models and their estimate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpc.cost import EuclideanSteps, GivenSteps, LearnedSteps, NoSteps, StepsToGo
from napsp.checkpoint import Model, load_model, shipped_model
from napsp.errors import UserError, load_object
from planners.options import PlanOptions


def load_models(options: PlanOptions, env_name: str) -> list[Model]:
    """The checkpoint to plan with, then those of the ensemble; none for a cost that needs no distance.

    Raises:
        UserError: a checkpoint is unusable, of another task, or lacks what the options ask of it.
    """
    if options.cost != "distance":
        return []
    model = load_model(options.checkpoint or shipped_model(env_name), env_name)
    if model.distance is None:
        raise UserError("this checkpoint holds no distance (method sparse); use --cost sparse or another one")
    if options.pessimism and model.visits is None:
        raise UserError(
            f"--pessimism needs visit counts and this checkpoint holds none; train one with: python -m napsp.train "
            f"--env {env_name}, then pass it with --checkpoint, or use --ensemble"
        )
    ensemble = [load_model(path, env_name) for path in options.ensemble]
    for path, member in zip(options.ensemble, ensemble, strict=True):
        if member.distance is None:
            raise UserError(f"{path} of --ensemble holds no distance (method sparse); leave it out")
        if member.header["sizes"] != model.header["sizes"]:
            raise UserError(f"{path} of --ensemble was trained on another version of {env_name}; train it again")
    return [model, *ensemble]


def steps_to_go(options: PlanOptions, models: Sequence[Model], world: Any) -> StepsToGo:
    """The estimate that ``--cost`` names.

    Raises:
        UserError: it is not known for this task.
    """
    if models:
        return LearnedSteps(models[0], options.pessimism, models[1:])
    if options.cost == "shortest_path":
        if not hasattr(world, "shortest_steps"):
            raise UserError(f"the true shortest path of {options.env} is not known; use --cost euclidean or distance")
        return GivenSteps(world.shortest_steps)
    if ":" in options.cost:
        return GivenSteps(load_object(options.cost))
    return EuclideanSteps(world.step_length) if options.cost == "euclidean" else NoSteps()
