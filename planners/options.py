"""The options of the planning commands; ``--help`` is made from these dataclasses."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from napsp.envs import canonical_name
from napsp.errors import UserError

COSTS = ("distance", "euclidean", "sparse", "shortest_path")


RANGES: dict[str, tuple[float, float]] = {
    **dict.fromkeys(("episodes", "samples", "horizon", "knots", "refinements", "threads"), (1, 10**6)),
    "seed": (0, 2**31 - 1),
    "video_episodes": (0, 10**6),
    "noise_scale": (0, 100),
    "noise_correlation": (0, 0.999),
    "noise_exponent": (0, 10),
    "min_noise_scale": (0, 100),
    "momentum": (0, 1),
    "decay": (1, 1000),
    "kept": (0, 1),
    "elites": (1, 10**6),
    "temperature": (1e-9, 1e9),
}


@dataclass(frozen=True)
class PlanOptions:
    """Plan with MuJoCo rollouts, step after step, and report how it went."""

    env: str = "fetch_wall"
    """Task: point_maze, point_maze_long, fetch_reach, fetch_wall (= fetch_reach_wall),
    fetch_pick_place, fetch_pick_place_wall or claw;
    a Gymnasium id such as FetchPush-v4, or your own module:Class."""
    episodes: int = 10
    """Episodes to run, on the seeds seed, seed + 1, ..."""
    seed: int = 0
    """Seed of tasks and of planning."""
    goal: tuple[float, ...] | None = None
    """One fixed goal for all episodes instead of the task's random ones, in metres
    (claw: sine and cosine of the valve's angle)."""
    cost: str = "distance"
    """Steps to go at a state: distance (the learned one), euclidean (straight line at full speed),
    sparse (nothing: only reaching the goal within the horizon counts), shortest_path (the true one,
    mazes only), or a function of your own as module:function, which maps achieved goals (B, G) and
    a goal (G,) to steps (B,)."""
    where: Literal["terminal", "mean", "both"] = "mean"
    """Where the plan is charged for its steps to go: at its end, on average along it, or both."""
    action_of: Literal["policy", "plan"] = "policy"
    """The action in d(s, a, g): the policy's, or the plan's own (its last one is not simulated)."""
    samples: int = 64
    """Plans per refinement."""
    horizon: int | None = None
    """Control steps per plan; default by task (5 for reaching, 15 for pick and place, 10 for the claw,
    16 for the mazes)."""
    knots: int | None = None
    """Spline knots per plan; default one per control step."""
    interpolation: Literal["zero", "linear", "cubic"] = "linear"
    """How knots become controls."""
    refinements: int = 1
    """Rounds of sampling per plan."""
    proposals: bool = True
    """With the learned distance: let the rollout of the policy that was trained with it join
    the samples, which keeps the search near states that d has seen. Other costs go without."""
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

    def hash(self) -> str:
        """Short hash of how plans are made: equal hashes plan alike with equal checkpoints and seeds."""
        elsewhere = ("episodes", "seed", "checkpoint", "out", "video", "video_episodes", "threads")
        asked = {k: v for k, v in asdict(self).items() if k not in elsewhere and (k not in ADDED or v != ADDED[k])}
        asked |= {"env": canonical_name(self.env), "horizon": self.steps_ahead}
        return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()[:10]

    @property
    def steps_ahead(self) -> int:
        """H, control steps per plan."""
        return self.horizon or HORIZONS.get(canonical_name(self.env), DEFAULT_HORIZON)

    def __post_init__(self) -> None:
        if self.cost not in COSTS and ":" not in self.cost:
            raise UserError(f"unknown cost {self.cost!r}; choose one of: {', '.join(COSTS)}, or module:function")
        for name, (low, high) in RANGES.items():
            value = getattr(self, name, None)
            if value is not None and not low <= value <= high:  # false for NaN as well
                raise UserError(f"--{name.replace('_', '-')} is {value}; it must lie between {low:g} and {high:g}")
        if getattr(self, "elites", 1) > self.samples:
            raise UserError(f"--elites exceeds the {self.samples} samples; use fewer elites or more samples")


@dataclass(frozen=True)
class MPPIOptions(PlanOptions):
    """Plan with MPPI: the exponentially weighted mean of noisy plans."""

    noise_scale: float = 0.8
    """Standard deviation of the sampled noise; actions lie in [-1, 1]."""
    noise_correlation: float = 0.6
    """Correlation of the noise between neighbouring knots."""
    temperature: float = 0.2
    """MPPI's lambda, in standard deviations of the sampled costs."""


@dataclass(frozen=True)
class CEMOptions(PlanOptions):
    """Plan with the cross-entropy method: a Gaussian refitted to the best samples."""

    samples: int = 21
    """Plans per refinement."""
    refinements: int = 3
    """Rounds of sampling per plan."""
    elites: int = 6
    """How many of the best plans the Gaussian is fitted to."""
    noise_scale: float = 0.8
    """Standard deviation before the first refinement; actions lie in [-1, 1]."""
    min_noise_scale: float = 0.05
    """The deviation does not shrink below this."""
    momentum: float = 0.1
    """Weight of the old mean and deviation in the new ones."""


@dataclass(frozen=True)
class ICEMOptions(PlanOptions):
    """Plan with iCEM: the cross-entropy method with coloured noise and kept elites."""

    samples: int = 26
    """Plans in the first refinement; later ones get fewer (--decay)."""
    refinements: int = 3
    """Rounds of sampling per plan."""
    decay: float = 1.25
    """Factor between the samples of one refinement and the next."""
    elites: int = 6
    """How many of the best plans the Gaussian is fitted to."""
    kept: float = 0.3
    """Share of the elites that is tried again, in the next refinement and the next step."""
    noise_scale: float = 0.5
    """Standard deviation before the first refinement; actions lie in [-1, 1]."""
    noise_exponent: float = 3.0
    """How fast the noise's power falls with frequency; 0 is white noise."""
    momentum: float = 0.1
    """Weight of the old mean and deviation in the new ones."""


@dataclass(frozen=True)
class PredictiveSamplingOptions(PlanOptions):
    """Plan with predictive sampling: noise around the best plan so far."""

    noise_scale: float = 0.8
    """Standard deviation of the sampled noise; actions lie in [-1, 1]."""
    noise_correlation: float = 0.6
    """Correlation of the noise between neighbouring knots."""


OPTIONS: dict[str, type[PlanOptions]] = {
    "mppi": MPPIOptions,
    "cem": CEMOptions,
    "icem": ICEMOptions,
    "predictive_sampling": PredictiveSamplingOptions,
}
HORIZONS = {
    **dict.fromkeys(("point_maze", "point_maze_long"), 16),
    **dict.fromkeys(("fetch_reach", "fetch_wall"), 5),
    **dict.fromkeys(("fetch_pick_place", "fetch_pick_place_wall"), 15),
    **dict.fromkeys(("fetch_pick_place_plain", "fetch_pick_place_wall_plain"), 15),
    "claw": 10,
}
DEFAULT_HORIZON = 8  # of tasks without an entry
# Options added after results existed, with the value that means what was done before; see PlanOptions.hash.
ADDED: dict[str, object] = {}
