"""What a user of the studio chooses: the same configuration and circumstances as on a planner's command line."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mpc.knots import SplineConfig
from mpc.smoothing.config import SmoothingConfig
from napsp.envs import canonical_name
from napsp.errors import UserError
from napsp.settings import changed
from napsp.storage.shipped import MODEL_FILE, named_after, shipped_names
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.searches import SEARCHES


@dataclass(frozen=True)
class Choices:
    """What is planned, and how.

    Attributes:
        plan: how plans are made.
        run: seed, checkpoint and threads; the rest means nothing here.
        switched_off: how this search's plans were smoothed before that was switched off; the switch brings it back.
    """

    plan: PlanConfig[Any]
    run: RunOptions
    switched_off: SmoothingConfig | None = None

    def changed(self, name: str, value: Any) -> Choices:
        """The same with another value.

        Args:
            name: an option of the planner's command line by its dotted name, such as ``search.samples``; or
                ``planner``, ``seed`` or ``checkpoint``. ``smooth`` is a switch.
            value: its value; None is the task's or the search's own.

        Raises:
            UserError: there is no such option, or the value is impossible or does not fit the others.
        """
        try:
            return self._changed(name, value)
        except ValueError as error:  # of a search's configuration, which knows no user
            raise UserError(str(error)) from None

    def _changed(self, name: str, value: Any) -> Choices:
        plan, run = self.plan, self.run
        if name == "seed":
            return replace(self, run=replace(run, seed=value))
        if name == "checkpoint":
            return replace(self, run=replace(run, checkpoint=None if value is None else Path(value)))
        if name == "env":  # what was chosen for another task does not fit this one
            distance = replace(plan.distance, ensemble=())
            model = replace(plan.model, substeps=None)
            plan = replace(
                plan, env=value, goal=None, horizon=None, spline=SplineConfig(), distance=distance, model=model
            )
            if hasattr(plan.search, "finest"):
                plan = changed(plan, {"search.finest": SEARCHES[plan.planner].config().finest})
            return replace(self, plan=plan, run=replace(run, checkpoint=None))
        if name == "planner":
            if value not in SEARCHES:
                raise UserError(f"there is no search {value!r}; choose from: {', '.join(SEARCHES)}")
            usual, own = PlanConfig.of(value), PlanConfig.of(plan.planner)
            smooth = usual.smooth or (None if own.smooth else plan.smooth)  # what the user switched on stays
            return Choices(replace(plan, planner=value, search=usual.search, smooth=smooth), run)
        if name == "smooth":
            smooth, last = PlanConfig.of(plan.planner, {"smooth": value}).smooth, plan.smooth or self.switched_off
            return Choices(replace(plan, smooth=smooth and (last or smooth)), run, None if value else last)
        return replace(self, plan=changed(plan, {name: value}))

    @property
    def values(self) -> dict[str, Any]:
        """What is chosen now, by the names of :meth:`changed`; the task's where nothing was asked for."""
        plan, run = self.plan, self.run
        search = {f"search.{name}": value for name, value in vars(plan.resolved().search).items()}
        return search | {
            "env": canonical_name(plan.env),
            "planner": plan.planner,
            "checkpoint": None if run.checkpoint is None else str(run.checkpoint),
            "seed": run.seed,
            "horizon": plan.horizon or plan.usual.horizon,
            "cost": plan.cost,
            "where": plan.where,
            "action_of": plan.action_of,
            "proposals": plan.proposals,
            "smooth": plan.smooth is not None,
            "distance.pessimism": plan.distance.pessimism,
        }


def checkpoints(task: str) -> list[str]:
    """Models of a task, to be named as checkpoints: those that ship, then folders of ``runs/`` called after it."""
    trained = sorted(path.parent for path in Path("runs").glob(f"*/{MODEL_FILE}"))
    return [*shipped_names(task), *(str(path) for path in trained if named_after(path.name, task))]
