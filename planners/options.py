"""The options of the planning commands; ``--help`` is made from these dataclasses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

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
