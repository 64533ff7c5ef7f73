"""The options of the planning commands; ``--help`` is made from these dataclasses."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from napsp.envs import canonical_name
from napsp.envs.cards import CARDS, UNKNOWN, Planning
from napsp.errors import UserError

COSTS = ("distance", "euclidean", "sparse", "shortest_path")
SWITCHES = ("smooth", "low_pass", "pessimism", "ensemble", "greedy_proposals")

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
    **dict.fromkeys(("smooth_rate", "smooth_jerk", "smooth_distance"), (0, 1e6)),
    "smooth_effort": (1e-6, 1e6),
    "smooth_choice": (1e-6, 1e6),
    "smooth_step": (1e-4, 0.5),
    "smooth_trust": (0.05, 1),
    "smooth_rounds": (1, 100),
    "smooth_tolerance": (0, 1e6),
    "low_pass": (0, 0.999),
    "pessimism": (0, 1e6),
    "planning_substeps": (1, 10**6),
}


@dataclass(frozen=True)
class PlanOptions:
    """Plan with MuJoCo rollouts, step after step, and report how it went."""

    env: str = "fetch_wall"
    """Task: point_maze, point_maze_long, fetch_reach, fetch_wall (= fetch_reach_wall), fetch_wall_high,
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
    """Control steps per plan; default by task (5 for reaching, 8 for pick and place, 15 with its plain
    goals, 10 for the claw, 16 for the mazes)."""
    knots: int | None = None
    """Spline knots per plan; default one per control step."""
    interpolation: Literal["zero", "linear", "cubic"] = "linear"
    """How knots become controls."""
    refinements: int = 1
    """Rounds of sampling per plan."""
    proposals: bool = True
    """With the learned distance: let the rollout of the policy that was trained with it join
    the samples, which keeps the search near states that d has seen. Other costs go without."""
    greedy_proposals: bool = False
    """With the learned distance: let a rollout that takes the action of least d(s, a, g) at every step join the
    samples. It asks the checkpoint's own d, without --ensemble and --pessimism, and costs about half a millisecond
    per step of the plan."""
    checkpoint: Path | None = None
    """A file or folder written by napsp.train, or the name of one that ships, such as
    fetch_pick_place_first_arrival; default: the one that ships for the task.
    A cost that needs no distance needs no checkpoint."""
    pessimism: float = 0.0
    """With the learned distance: plan with d + pessimism * U, where U = C / (1 + N(s, a))^M of eq. 2, in steps, is
    large where training hardly went. The checkpoint has to hold the counts N; older files do not."""
    ensemble: tuple[Path, ...] = ()
    """Further checkpoints of the same task: the largest of all distances counts, so that a plan must look short to
    every one. All are asked at the same action, that of the main checkpoint's policy or the plan's (--action-of)."""
    planning_model: Literal["exact", "coarse"] = "exact"
    """Simulate plans in the environment's own model, or in a coarser and faster one: longer physics steps and, for
    Fetch, a lower arm that passes table and box. The environment always runs its own; --smooth, and the costs reported,
    go by the model planned in."""
    planning_substeps: int | None = None
    """Physics steps per control step of the coarse model, at most the environment's; default by task, chosen by the
    error that benchmarks.coarse_model measures. Too few, such as 2 for Fetch, and the gripper gets past a wall."""
    out: Path | None = None
    """Folder of the results; default plans/ENV-PLANNER-COST-sSEED."""
    video: bool = True
    """Render the first episodes with the goal and the sampled plans."""
    video_episodes: int = 2
    """How many episodes the video shows."""
    render: Literal["none", "human"] = "none"
    """human: watch the episodes in Gymnasium's viewer as they run. It needs a display, and no video is made then:
    off-screen frames and the window would compete for OpenGL."""
    threads: int | None = None
    """Simulations at once, in threads or processes; default all cores. Plans do not depend on it."""
    smooth: bool = False
    """Smooth every plan with CasADi, the learned distance as cost; a smoother plan is executed only if
    rolling it out shows that the planner's own cost did not rise."""
    smooth_rate: float = 1.0
    """Weight, in steps, of squared changes from one action to the next."""
    smooth_jerk: float = 0.3
    """Weight of squared changes of those changes."""
    smooth_effort: float = 0.01
    """Weight of squared actions."""
    smooth_distance: float = 1.0
    """Weight of the learned distance."""
    smooth_multiples: tuple[float, ...] | None = None
    """Solve with changes weighed so many times as heavily, and verify all answers together; default by task
    (0.3, 1, 3 and 10; 1 for the mazes, where four solutions would take longer than the search)."""
    smooth_choice: float | None = None
    """Weight of smoothness against the planner's own cost in choosing between plans that cost no more than the
    sampled one; the smaller, the rarer a plan is replaced. Default 10 with several --smooth-multiples, else 1."""
    smooth_along: bool = True
    """Read the distance at the states where the planner's cost reads it (--where); otherwise at the end only."""
    smooth_trust: float = 0.3
    """How far an action may be moved at first; adapts from step to step."""
    smooth_rounds: int = 1
    """Linearise, solve and verify so many times per plan."""
    smooth_tolerance: float = 0.0
    """Smoothing may raise the planner's cost by so many steps."""
    smooth_accept: Literal["smoother", "better"] = "smoother"
    """What a smoothed plan needs besides a cost that did not rise and a lower sum of cost and --smooth-choice times
    roughness: a lower action rate as well, or nothing more."""
    smooth_step: float = 0.1
    """Change of an action for the finite differences that linearise the simulator."""
    smooth_solver: Literal["qp", "ipopt"] = "qp"
    """Quadratic programs (daqp), or IPOPT: the same answers in several times the time."""
    low_pass: float = 0.0
    """Plain first-order filter of the plan instead, to compare with: the share of the action before in each one."""

    def hash(self) -> str:
        """Short hash of how plans are made: equal hashes plan alike with equal checkpoints and seeds."""
        elsewhere = ("episodes", "seed", "checkpoint", "out", "video", "video_episodes", "render", "threads")
        # Added after results existed: without them, plans are made as before.
        idle = [name for name in SWITCHES if not getattr(self, name)]
        idle += [] if self.smooth else [k for k in asdict(self) if k.startswith("smooth_")]
        idle += ["planning_model", "planning_substeps"] if self.planning_model == "exact" else []
        asked = {k: v for k, v in asdict(self).items() if k not in elsewhere and k not in idle}
        asked |= {"env": canonical_name(self.env), "horizon": self.steps_ahead}
        if self.ensemble:
            asked["ensemble"] = len(self.ensemble)  # paths do not count, as with the checkpoint
        if self.smooth:
            asked |= {"smooth_multiples": self.roughness_multiples, "smooth_choice": self.roughness_choice}
        if self.planning_model == "coarse":
            asked["planning_substeps"] = self.planning_substeps or self.usual.coarse_substeps
        return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()[:10]

    @property
    def usual(self) -> Planning:
        """What the task's card says."""
        name = canonical_name(self.env)
        return CARDS[name].planning if name in CARDS else UNKNOWN

    @property
    def steps_ahead(self) -> int:
        """H, control steps per plan."""
        return self.horizon or self.usual.horizon

    @property
    def roughness_multiples(self) -> tuple[float, ...]:
        """What smoothing multiplies the weights of changes with, one problem each."""
        if self.smooth_multiples is not None:
            return self.smooth_multiples
        return self.usual.smoothing_multiples

    @property
    def roughness_choice(self) -> float:
        """What smoothing multiplies roughness with when it chooses between plans."""
        if self.smooth_choice is not None:
            return self.smooth_choice
        return 10.0 if len(self.roughness_multiples) > 1 else 1.0

    def coarse_substeps(self, own: int) -> int:
        """Physics steps per control step of the coarse model of a task that runs ``own``."""
        default = self.usual.coarse_substeps or max(1, own // 4)
        return self.planning_substeps or min(own, default)

    @property
    def n_proposals(self) -> int:
        """Rollouts of the policy, or of d's greedy actions, among the samples."""
        return (self.proposals + self.greedy_proposals) if self.cost == "distance" else 0

    @property
    def least_samples(self) -> int:
        """Plans that are tried whatever the noise, and one with noise: with fewer there is no search."""
        return 1

    def __post_init__(self) -> None:
        if self.cost not in COSTS and ":" not in self.cost:
            raise UserError(f"unknown cost {self.cost!r}; choose one of: {', '.join(COSTS)}, or module:function")
        for name, (low, high) in RANGES.items():
            value = getattr(self, name, None)
            if value is not None and not low <= value <= high:  # false for NaN as well
                raise UserError(f"--{name.replace('_', '-')} is {value}; it must lie between {low:g} and {high:g}")
        if self.samples < self.least_samples:
            raise UserError(
                f"--samples is {self.samples}; the last plans and proposals take {self.least_samples - 1} of them, "
                f"so give at least {self.least_samples}"
            )
        if getattr(self, "elites", 1) > self.samples:
            raise UserError(f"--elites exceeds the {self.samples} samples; use fewer elites or more samples")
        if self.smooth and self.cost != "distance":
            raise UserError(f"--smooth needs --cost distance: it minimises the learned distance, not {self.cost}")
        multiples = self.roughness_multiples
        if not multiples or not all(0 < multiple <= 1e6 for multiple in multiples):  # false for NaN as well
            raise UserError(f"--smooth-multiples is {multiples}; give one or more positive numbers of at most 1e+06")
        if self.smooth and self.low_pass:
            raise UserError("--smooth and --low-pass exclude each other; use one of them")
        for name in ("pessimism", "ensemble", "greedy_proposals"):
            if self.cost != "distance" and getattr(self, name):
                option = f"--{name.replace('_', '-')}"
                raise UserError(f"{option} needs --cost distance: {self.cost} is no learned distance")
        if self.planning_model == "exact" and self.planning_substeps is not None:
            raise UserError(
                "--planning-substeps needs --planning-model coarse: the exact one has the environment's own"
            )
