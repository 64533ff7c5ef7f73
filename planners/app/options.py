"""The command line of the planners: how plans are made and the circumstances of a run, where ``--help`` comes from."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Generic, Literal

import tyro

from mpc.smoothing.config import SmoothingConfig
from napsp.command_line import Flat, ask
from napsp.errors import UserError
from napsp.settings import FIRST_SEED, MANY, check_ranges, differences, refuse_old_flags
from planners.app.config import PlanConfig, S

RENAMED = {
    "no-smooth-along": "smooth.no-along",
    "knots": "spline.knots",
    "interpolation": "spline.interpolation",
    "planning-model": "model.kind",
    "planning-substeps": "model.substeps",
    "pessimism": "distance.pessimism",
    "ensemble": "distance.ensemble",
    "greedy-proposals": "distance.greedy-proposals",
    "no-greedy-proposals": "distance.no-greedy-proposals",
}
"""What options were called before they had groups, beside those of the search (``--temperature``) and of smoothing
(``--smooth-rate``), whose names tell."""


@dataclass(frozen=True)
class RunOptions:
    """The circumstances of a run: they choose what is planned and shown, not how plans are made."""

    episodes: Flat[int] = 5
    """Episodes to run, on the seeds seed, seed + 1, ..., whatever comes of them."""
    seed: Flat[int] = FIRST_SEED
    """Seed of the first episode, its task and its planning. The default episodes are the first of the 50 that the
    published results of planners are measured on, so that they can be compared."""
    hold: Flat[int] = 10
    """End an episode once the goal has been held for so many control steps in succession; 0 plans it to its time limit,
    as the published results do."""
    checkpoint: Flat[Path | None] = None
    """A file or folder written by napsp.train, or the name of one that ships, such as
    fetch_pick_place_first_arrival; default: the one that ships for the task.
    A cost that needs no distance needs no checkpoint."""
    out: Flat[Path | None] = None
    """Folder of the results; default plans/ENV-PLANNER-COST-sSEED, and a few digits more with options that
    make other plans, another checkpoint, or other numbers of --episodes or --hold."""
    video: Flat[bool] = True
    """Render the first episodes with the goal and the sampled plans."""
    video_episodes: Flat[int] = 2
    """How many episodes the video shows."""
    render: Flat[Literal["none", "human"]] = "none"
    """human: watch the episodes in Gymnasium's viewer as they run. It needs a display, and no video is made then:
    off-screen frames and the window would compete for OpenGL."""
    threads: Flat[int | None] = None
    """Simulations at once, in threads or processes; default all cores. Plans do not depend on it."""

    def __post_init__(self) -> None:
        check_ranges(self, episodes=(1, MANY), threads=(1, MANY), seed=(0, 2**31 - 1), video_episodes=(0, MANY))
        check_ranges(self, hold=(0, MANY))


@dataclass(frozen=True)
class Command(Generic[S]):
    """Plan with MuJoCo rollouts, step after step, and report how it went."""

    plan: Annotated[PlanConfig[S], tyro.conf.arg(name="")]
    run: RunOptions
    smooth: bool = False
    """Smooth every plan with CasADi, the learned distance as cost; a smoother plan is executed only if
    rolling it out shows that the planner's own cost did not rise."""
    smoothing: Annotated[SmoothingConfig, tyro.conf.arg(name="smooth")] = field(default_factory=SmoothingConfig)


def parse(
    planner: str, arguments: list[str], others: Sequence[str] = (), prog: str | None = None
) -> tuple[PlanConfig[Any], RunOptions]:
    """The configuration and the circumstances that a command line asks for.

    ``others`` are options that the command has beside these, and may have been meant by one that is unknown; ``prog``
    is the command, ``python -m planners.NAME`` if None.

    Raises:
        UserError: an option has another name now, or a value is out of its range or does not fit the others.
    """
    usual = PlanConfig.of(planner)
    kind = type(usual.search)
    if "samples" not in {option.name for option in dataclasses.fields(kind)}:
        _refuse_samples(planner, arguments)
    shown = _on_the_command_line(kind)
    default = Command(
        replace(usual, search=shown(), smooth=None),
        RunOptions(),
        usual.smooth is not None,
        usual.smooth or SmoothingConfig(),
    )
    names = _names(default)
    refuse_old_flags(arguments, old_names(names))
    prog = prog or f"python -m planners.{planner}"
    try:
        asked: Command[Any] = ask(Command[shown], arguments, prog, [*names, *others], default=default)
        own = {f.name: getattr(asked.plan.search, f.name) for f in dataclasses.fields(kind)}
        if asked.smoothing != default.smoothing and not asked.smooth and "--no-smooth" not in arguments:
            named = next(iter(differences(asked.smoothing, default.smoothing)))
            raise UserError(f"--smooth.{named.replace('_', '-')} needs --smooth, which is off")
        if asked.run.checkpoint is not None and asked.plan.cost not in ("distance",):
            raise UserError(f"--checkpoint needs --cost distance: {asked.plan.cost} asks no learned distance")
        smooth = asked.smoothing if asked.smooth else None
        return replace(asked.plan, search=kind(**own), smooth=smooth), asked.run
    except UserError as error:
        raise UserError(_with_flag(str(error), names)) from None


def old_names(names: list[str]) -> dict[str, str]:
    """What options were called before they had groups, and their ``names`` now, as they are typed."""
    found, typed = dict(RENAMED), [name.replace("_", "-") for name in names]
    for name in typed:
        group, _, option = name.partition(".")
        if group == "search" and option not in typed:
            found[option] = name
        elif group == "smooth" and option:
            found[f"smooth-{option}"] = name
    return found


def _refuse_samples(planner: str, arguments: list[str]) -> None:
    if any(argument.partition("=")[0] == "--samples" for argument in arguments):
        raise UserError(f"--samples means nothing to planners.{planner}, which draws no samples; leave it out")


def _on_the_command_line(kind: type) -> Any:
    """A search's configuration with ``--samples`` beside ``--search.samples``, and a bad value as the user's error."""

    def check(self: Any) -> None:
        try:
            kind.__post_init__(self)  # type: ignore[attr-defined]
        except ValueError as error:  # tyro would frame it
            raise UserError(str(error)) from None

    flat = tyro.conf.arg(prefix_name=False, aliases=["--search.samples"], help="N, plans per refinement.")
    samples = [(f.name, Annotated[int, flat], f.default) for f in dataclasses.fields(kind) if f.name == "samples"]
    namespace = {"__doc__": kind.__doc__, **({"__post_init__": check} if hasattr(kind, "__post_init__") else {})}
    return dataclasses.make_dataclass(kind.__name__, samples, bases=(kind,), namespace=namespace, frozen=True)


def _names(command: Command[Any]) -> list[str]:
    """What the options are called, with their groups."""
    found = []
    for prefix, config in (("", command.plan), ("", command.run), ("smooth.", command.smoothing)):
        for option in dataclasses.fields(config):
            value = getattr(config, option.name)
            nested = dataclasses.fields(value) if dataclasses.is_dataclass(value) else ()
            found += [f"{option.name}.{inner.name}" for inner in nested] or [prefix + option.name]
    return ["samples" if name == "search.samples" else name for name in found]


def _with_flag(message: str, names: list[str]) -> str:
    """``rate is -1; ...`` as ``--smooth.rate is -1; ...``, where one option alone can be meant."""
    word, _, rest = message.partition(" ")
    meant = [name for name in names if name.rpartition(".")[2] == word]
    return f"--{meant[0].replace('_', '-')} {rest}" if len(meant) == 1 and rest.startswith("is ") else message
