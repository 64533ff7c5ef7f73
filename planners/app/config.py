"""What decides how plans are made: one configuration of frozen dataclasses, which is its own identity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar

import tyro

from mpc.knots import SplineConfig
from mpc.reading import ActionOf, Where
from mpc.smoothing.config import SmoothingConfig
from napsp.envs import canonical_name
from napsp.envs.cards import CARDS, UNKNOWN, Planning
from napsp.errors import UserError, choose
from napsp.settings import MANY, changed, check_ranges, differences, of_kind
from planners.app.searches import SEARCHES

COSTS = ("distance", "euclidean", "sparse", "shortest_path")
S = TypeVar("S")


@dataclass(frozen=True)
class ModelConfig:
    """The model that plans are simulated in; the environment always runs its own."""

    kind: Literal["exact", "coarse"] = "exact"
    """The environment's own, or a coarser and faster one: longer physics steps and, for Fetch, a lower arm that passes
    table and box. Smoothing, and the costs reported, go by the model planned in."""
    substeps: int | None = None
    """Physics steps per control step of the coarse model, at most the environment's; default by task, chosen by the
    error that benchmarks.coarse_model measures. Too few, such as 2 for Fetch, and the gripper gets past a wall."""

    def __post_init__(self) -> None:
        check_ranges(self, substeps=(1, MANY))
        if self.kind == "exact" and self.substeps is not None:
            raise UserError("--model.substeps needs --model.kind coarse: the exact one has the environment's own")


@dataclass(frozen=True)
class DistanceConfig:
    """How the learned distance is asked (--cost distance)."""

    pessimism: float = 0.0
    """Plan with d + pessimism * U, where U = C / (1 + N(s, a))^M of eq. 2, in steps, is large where training hardly
    went. The checkpoint has to hold the counts N; older files do not."""
    ensemble: tuple[Path, ...] = ()
    """Further checkpoints of the same task: the largest of all distances counts, so that a plan must look short to
    every one. All are asked at the same action, that of the main checkpoint's policy or the plan's (--action-of)."""
    greedy_proposals: bool = False
    """Let a rollout that takes the action of least d(s, a, g) at every step join the samples. It asks the checkpoint's
    own d, without ensemble and pessimism, and costs about half a millisecond per step of the plan."""

    def __post_init__(self) -> None:
        check_ranges(self, pessimism=(0, 1e6))


@dataclass(frozen=True)
class PlanConfig(Generic[S]):
    """How plans are made: equal configurations plan alike with equal checkpoints and seeds."""

    planner: tyro.conf.Suppress[str]
    """Name of the search."""
    search: S
    env: str = "fetch_wall"
    """Task: point_maze, point_maze_long, fetch_reach, fetch_wall (= fetch_reach_wall), fetch_wall_high,
    fetch_pick_place, fetch_pick_place_wall or claw;
    a Gymnasium id such as FetchPush-v4, or your own module:Class."""
    goal: tuple[float, ...] | None = None
    """One fixed goal for all episodes instead of the task's random ones, in metres
    (claw: sine and cosine of the valve's angle)."""
    cost: str = "distance"
    """Steps to go at a state: distance (the learned one), euclidean (straight line at full speed),
    sparse (nothing: only reaching the goal within the horizon counts), shortest_path (the true one,
    mazes only), or a function of your own as module:function, which maps achieved goals (B, G) and
    a goal (G,) to steps (B,)."""
    reached: str | None = None
    """Success test of an environment that is planned in by its own get_state and set_state and whose rewards are dense:
    a radius in units of the goal, or module:function; default the one that the checkpoint was trained with."""
    where: Where = "mean"
    """Where the plan is charged for its steps to go: at its end, on average along it, or both."""
    action_of: ActionOf = "policy"
    """The action in d(s, a, g): the policy's, or the plan's own (its last one is not simulated)."""
    horizon: int | None = None
    """Control steps per plan; default by task (5 for reaching, 8 for pick and place, 15 with its plain
    goals, 10 for the claw, 16 for the mazes)."""
    proposals: bool = True
    """With the learned distance: let the rollout of the policy that was trained with it join
    the samples, which keeps the search near states that d has seen. Other costs go without."""
    low_pass: float = 0.0
    """Plain first-order filter of the plan, to compare smoothing with: the share of the action before in each one."""
    spline: SplineConfig = field(default_factory=SplineConfig)
    model: ModelConfig = field(default_factory=ModelConfig)
    distance: DistanceConfig = field(default_factory=DistanceConfig)
    # The command line has a switch --smooth and options --smooth.NAME, which it puts together.
    smooth: Annotated[SmoothingConfig | None, tyro.conf.Suppress, tyro.conf.arg(name="smoothing")] = None

    @classmethod
    def of(cls, planner: str, changes: Mapping[str, Any] | None = None) -> PlanConfig[Any]:
        """A planner's defaults with other values, by dotted names: ``{"cost": "sparse", "search.samples": 32}``.

        ``smooth`` is a switch here, as on the command line.

        Raises:
            UserError: there is no search or option of a name, or a value does not fit it or the others.
        """
        if planner not in SEARCHES:
            raise UserError(f"there is no search {planner!r}; {choose(planner, SEARCHES)}")
        usual, asked = SEARCHES[planner], dict(changes or {})
        smooth = of_kind("smooth", asked.pop("smooth", usual.smooth is not None), bool)
        base = cls(planner, usual.config(), smooth=(usual.smooth or SmoothingConfig()) if smooth else None)  # type: ignore[arg-type]
        if not smooth:  # switched off, its options may stay where they are
            idle = {name: asked.pop(name) for name in list(asked) if name.startswith("smooth.")}
            changed(SmoothingConfig(), {name.removeprefix("smooth."): value for name, value in idle.items()})
            if idle and "smooth" not in (changes or {}):
                raise UserError(f"--{next(iter(idle)).replace('_', '-')} needs --smooth, which is off")
        try:
            return changed(base, asked)
        except ValueError as error:  # of a search, which knows no users
            raise UserError(str(error)) from None

    @property
    def usual(self) -> Planning:
        """What the task's card says."""
        name = canonical_name(self.env)
        return CARDS[name].planning if name in CARDS else UNKNOWN

    @property
    def n_proposals(self) -> int:
        """Rollouts of the policy, or of d's greedy actions, among the samples."""
        return (self.proposals + self.distance.greedy_proposals) if self.cost == "distance" else 0

    def resolved(self) -> PlanConfig[S]:
        """With the task's values, and its one name, where defaults depend on the task.

        How many physics steps the coarse model of an unknown task has is known only to the task itself.
        """
        usual, model = self.usual, self.model
        if model.kind == "coarse":
            model = replace(model, substeps=model.substeps or usual.coarse_substeps)
        smooth = self.smooth and self.smooth.resolved(usual.smoothing_multiples)
        horizon, search = self.horizon or usual.horizon, self.search
        if getattr(search, "finest", usual.finest) is None:
            search = replace(search, finest=usual.finest)  # type: ignore[type-var]
        return replace(self, env=canonical_name(self.env), search=search, horizon=horizon, model=model, smooth=smooth)

    def identity(self) -> dict[str, Any]:
        """What differs from the planner's defaults, by dotted names; planner and task stand beside it.

        The task's values count as differences, so that a result remembers them when a card changes; noise of one size
        does only where the task's shrinks. Of an ensemble it is the number that counts: paths, as that of the
        checkpoint, are circumstances.
        """
        own, usual = self.resolved(), PlanConfig.of(self.planner)
        if self.usual.finest == UNKNOWN.finest and getattr(usual.search, "finest", 1.0) is None:
            usual = changed(usual, {"search.finest": UNKNOWN.finest})
        switched = (own.smooth is None) != (usual.smooth is None)
        if switched:  # what an option that is off would be is no difference, nor are defaults of one that is on
            usual = replace(usual, smooth=own.smooth and SmoothingConfig())
        paths = own.distance.ensemble
        found = differences(replace(own, distance=replace(own.distance, ensemble=())), replace(usual, env=own.env))
        found |= {"smooth": own.smooth is not None} if switched else {}
        return found | ({"distance.ensemble": len(paths)} if paths else {})

    def __post_init__(self) -> None:
        if self.cost not in COSTS and ":" not in self.cost:
            raise UserError(f"unknown cost {self.cost!r}; {choose(self.cost, COSTS, ', or module:function')}")
        check_ranges(self, horizon=(1, MANY), low_pass=(0, 0.999))
        search: Any = self.search
        least = search.least_samples(self.n_proposals)
        if search.samples < least:
            raise UserError(
                f"--samples is {search.samples}; the last plans and proposals take {least - 1} of them, "
                f"so give at least {least}"
            )
        ahead, knots = self.horizon or self.usual.horizon, self.spline.knots
        if knots is not None and knots > ahead:
            raise UserError(f"--spline.knots {knots} exceeds the horizon of {ahead} steps; use at most {ahead}")
        if self.action_of == "plan" and self.cost != "distance":
            raise UserError(f"--action-of plan needs --cost distance: {self.cost} does not read actions")
        if self.smooth and self.cost != "distance":
            raise UserError(f"--smooth needs --cost distance: it minimises the learned distance, not {self.cost}")
        if self.smooth and self.low_pass:
            raise UserError("--smooth and --low-pass exclude each other; use one of them")
        for name in ("pessimism", "ensemble", "greedy_proposals"):
            if self.cost != "distance" and getattr(self.distance, name):
                option = f"--distance.{name.replace('_', '-')}"
                raise UserError(f"{option} needs --cost distance: {self.cost} is no learned distance")
