"""The command shared by all planners: ``python -m planners.mppi --env fetch_wall``."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from planners.gl import choose_gl

CostName = Literal["distance", "euclidean", "sparse"]


@dataclass(frozen=True)
class PlanOptions:
    """Plan with MuJoCo rollouts, step after step, and report how it went."""

    env: str = "fetch_wall"
    """Task: point_maze, point_maze_long, fetch_reach or fetch_wall (= fetch_reach_wall)."""
    episodes: int = 10
    """Episodes to run, on the seeds seed, seed + 1, ..."""
    seed: int = 0
    """Seed of tasks and of planning."""
    goal: tuple[float, ...] | None = None
    """One fixed goal for all episodes instead of the task's random ones, in metres."""
    cost: CostName = "distance"
    """Steps to go at a state: the learned distance, straight-line distance at full speed,
    or nothing (sparse: only reaching the goal within the horizon counts)."""
    where: Literal["terminal", "mean", "both"] = "mean"
    """Where the plan is charged for its steps to go: at its end, on average along it, or both."""
    action_of: Literal["policy", "plan"] = "policy"
    """The action in d(s, a, g): the policy's, or the plan's own (its last one is not simulated)."""
    samples: int = 64
    """Plans per refinement."""
    horizon: int | None = None
    """Control steps per plan; default by task (5 for Fetch, 8 for the mazes)."""
    knots: int | None = None
    """Spline knots per plan; default one per control step."""
    interpolation: Literal["zero", "linear", "cubic"] = "linear"
    """How knots become controls."""
    refinements: int = 1
    """Rounds of sampling per plan."""
    proposals: bool = False
    """Let the policy's own rollout join the samples."""
    checkpoint: Path | None = None
    """A file or folder written by napsp.train; default: the one that ships with the package.
    A cost that needs no distance needs no checkpoint."""
    out: Path | None = None
    """Folder of the results; default plans/ENV-PLANNER-COST-sSEED."""
    video: bool = True
    """Render the first episodes with the goal and the sampled plans."""
    video_episodes: int = 2
    """How many episodes the video shows."""
    threads: int | None = None
    """Simulation threads; default all cores. Plans do not depend on it."""


@dataclass(frozen=True)
class MPPIOptions(PlanOptions):
    """Plan with MPPI: the exponentially weighted mean of noisy plans."""

    noise_scale: float = 0.8
    """Standard deviation of the sampled noise; actions lie in [-1, 1]."""
    noise_correlation: float = 0.6
    """Correlation of the noise between neighbouring knots."""
    temperature: float = 0.2
    """MPPI's lambda, in standard deviations of the sampled costs."""


OPTIONS: dict[str, type[PlanOptions]] = {"mppi": MPPIOptions}
HORIZONS = {"point_maze": 8, "point_maze_long": 8, "fetch_reach": 5, "fetch_wall": 5}


def main(planner: str) -> None:
    """Entry point of ``python -m planners.NAME``."""
    choose_gl()  # before anything imports mujoco
    from napsp.errors import run_command

    run_command(lambda: run(planner, sys.argv[1:]))


def run(planner: str, arguments: list[str]) -> int:
    """Plan the episodes, print the table, write the output folder."""
    import torch

    from napsp.errors import UserError
    from planners.report import Report
    from planners.session import Session
    from planners.video import Video

    options = tyro.cli(OPTIONS[planner], args=arguments, prog=f"python -m planners.{planner}")
    _check(options, UserError)
    torch.set_num_threads(1)  # d is a sliver of the work; its threads would fight the simulator's
    session = Session.open(planner, options)
    folder = options.out or Path("plans") / f"{session.env_name}-{planner}-{options.cost}-s{options.seed}"
    folder.mkdir(parents=True, exist_ok=True)
    report = Report(folder, session)
    report.announce()
    video = Video(folder / "video.mp4", session.env.unwrapped) if options.video else None
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        for episode in range(options.episodes):
            watch = video if video is not None and episode < options.video_episodes else None
            report.add(session.run_episode(options.seed + episode, watch))
    if video is not None:
        report.note(video.close())
    report.finish(session.raw_speed_fraction())
    session.close()
    return 0


def _check(options: PlanOptions, error: type[Exception]) -> None:
    for name in ("episodes", "samples", "horizon", "knots", "refinements", "threads"):
        value = getattr(options, name)
        if value is not None and value < 1:
            raise error(f"--{name} is {value}; it must be at least 1")
