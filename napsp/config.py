"""Every choice of the method in one frozen dataclass; ``napsp/presets.py`` has the values per task.

The paper's appendix with hyper-parameters is not public, so each value here is ours;
``docs/paper.md`` gives the reason and the experiment behind it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from typing import Any, Literal

from napsp.envs import canonical_name, episode_length
from napsp.errors import UserError

METHODS = ("sparse", "ddl", "offpolicy_ddl", "ours")
AGENTS = ("sac", "ddpg")
PRECISIONS = ("highest", "medium")


@dataclass(frozen=True)
class TrainConfig:
    """Options of Algorithm 1. Lengths are in control steps, distances in steps."""

    env: str = "fetch_wall"
    """Task: point_maze, point_maze_long, fetch_reach, fetch_wall, fetch_wall_high, fetch_pick_place,
    fetch_pick_place_wall or claw; a Gymnasium id such as FetchPush-v4, or your own module:Class."""
    method: str = "ours"
    """sparse: binary reward. ddl: on-policy temporal regression. offpolicy_ddl: eq. 4a.
    ours: eq. 4a and 4b (the paper)."""
    seed: int = 0
    """Seed of everything random in the run."""

    # -- amount of work --
    n_episodes: int = 500
    """Training episodes in total, warm-up included; rounded up to whole iterations."""
    n_warmup_episodes: int = 20
    """Episodes of random actions that seed the buffer D and set the input scaling."""
    rescale: bool = False
    """Estimate the input scaling anew each time D has doubled, not from the warm-up alone."""
    episodes_per_iteration: int = 2
    """Episodes collected per iteration (the size of D_last)."""
    n_temporal_updates: int = 50
    """Gradient steps on eq. 4a per iteration."""
    n_triangular_updates: int = 25
    """Gradient steps on eq. 4b per iteration."""
    n_policy_updates: int = 50
    """Policy updates per iteration."""
    batch_size: int = 256
    """Samples per gradient step, for every network."""
    matmul_precision: Literal["highest", "medium"] = "highest"
    """torch's precision of float32 matrix products while training; medium lets processors with
    bfloat16 units multiply up to four times faster, with 8-bit mantissas and float32 sums."""
    compiled: bool = False
    """Make one compiled program of a policy update and one of a step on eq. 4a (torch.compile; needs a C++ compiler;
    the first time this takes up to a minute). An update differs in rounding alone, so this is not part of the
    configuration's hash; runs drift apart from it as they do on another machine."""

    # -- distance network --
    hidden: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of every network."""
    distance_learning_rate: float = 1e-3
    """Adam step size of the distance network."""
    distance_output: Literal["linear", "softplus"] = "linear"
    """Output layer of d / T."""
    target_polyak: float = 1.0
    """Weight of the new parameters in the per-iteration target update; 1 copies (line 9)."""
    slow_distance: bool = False
    """Reward the policy with the target network, and save that one. With a small target_polyak it
    averages out what the last iteration's few episodes did to d."""
    first_arrival: bool = False
    """Label a pair with the steps to the first state after s_i that the task counts as being at its goal,
    not with j - i, which takes waiting at a goal for distance to it. Beyond the paper; not for sparse."""

    # -- uncertainty, eq. 2 --
    uncertainty_scale: float = 10.0
    """C of eq. 2, in steps."""
    uncertainty_power: float = 0.5
    """M of eq. 2."""
    visit_bits: int = 16
    """SimHash bits of N(s, a)."""
    reached_bits: int = 16
    """SimHash bits of N(s, a, g)."""

    # -- triangular loss, eq. 4b --
    triangular_weight: float = 1.0
    """Weight of eq. 4b against eq. 4a; 1 is the paper's plain sum."""
    triangular_mean: Literal["sampled", "passed"] = "sampled"
    """Average eq. 4b over all sampled tuples (Algorithm 1: the others "do nothing") or over
    those that pass the test (eq. 4b: a handful of tuples then weighs as much as a full batch)."""
    cap_triangular: bool = True
    """Clip the hypotenuse at the episode length T; without it the loss diverges."""
    require_reached_waypoint: bool = True
    """Algorithm 1, line 13: N(s_j, a_j, s_g) > 0. False follows the text of eq. 4b."""

    # -- on-policy DDL --
    ddl_window: int = 20
    """Most recent episodes that the on-policy regression of ddl sees."""

    # -- policy: HER + SAC or DDPG --
    agent: str = "sac"
    """Learner of the policy: sac, or ddpg (the paper's for pick-and-place)."""
    relabel_ratio: float = 0.8
    """Share of HER future goals, k / (k + 1); 0.8 is k = 4."""
    other_goals_ratio: float = 0.0
    """Share of goals taken from other episodes, desired and achieved ones in equal parts."""
    discount: float = 0.98
    """Discount of the policy's return."""
    policy_learning_rate: float = 1e-3
    """Adam step size of actor and critics."""
    clip_values: bool = True
    """Clip the critics' targets to [-1 / (1 - discount), 0], where the rewards alone would keep them."""
    polyak: float = 0.01
    """Weight of the new critic parameters in their target, per update."""
    entropy_weight: float | None = None
    """Fixed SAC alpha; None adapts it to a target entropy of minus the action size."""
    min_entropy_weight: float = 0.02
    """Floor of the adapted SAC alpha (rewards lie in [-1, 0])."""
    action_noise: float = 0.2
    """Standard deviation of DDPG's exploration noise; actions lie in [-1, 1]."""
    clipped_double_q: bool = False
    """Two critics for DDPG, which learn from the smaller of their values; SAC always has them."""
    action_penalty: float = 1.0
    """Weight of the mean squared action in DDPG's policy loss (HER's action_l2)."""

    # -- exploration --
    epsilon: float = 0.1
    """Chance per step to start a random action."""
    exploration_hold: int = 6
    """A random action is held for 1 to this many steps; 1 is plain epsilon exploration."""
    held_starts: float = 0.0
    """Share of training episodes that begin with the box in the gripper (pick and place only)."""

    # -- evaluation --
    evaluate_every: int = 50
    """Episodes between evaluations; each one also writes a checkpoint."""
    n_evaluation_episodes: int = 20
    """Episodes per evaluation, on goals that all methods and seeds share."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "env", canonical_name(self.env))
        object.__setattr__(self, "hidden", tuple(self.hidden))
        if self.method not in METHODS:
            raise UserError(f"unknown method {self.method!r}; choose one of: {', '.join(METHODS)}")
        if self.agent not in AGENTS:
            raise UserError(f"unknown agent {self.agent!r}; choose one of: {', '.join(AGENTS)}")
        if self.matmul_precision not in PRECISIONS:
            raise UserError(
                f"unknown matmul_precision {self.matmul_precision!r}; choose one of: {', '.join(PRECISIONS)}"
            )
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:  # false for NaN as well
                raise UserError(f"{name} is {value}; it must lie between {low:g} and {high:g}")
        if self.relabel_ratio + self.other_goals_ratio > 1:
            raise UserError(
                f"relabel_ratio {self.relabel_ratio} and other_goals_ratio {self.other_goals_ratio} exceed 1 together"
            )
        if not self.hidden or min(self.hidden) < 1:
            raise UserError(f"hidden is {self.hidden}; give at least one width of at least 1")
        n_warmup = -(-self.n_warmup_episodes // self.episodes_per_iteration) * self.episodes_per_iteration
        if self.n_episodes <= n_warmup:
            raise UserError(f"n_episodes is {self.n_episodes}; it must exceed the {n_warmup} warm-up episodes")

    @property
    def horizon(self) -> int:
        """T, the episode length in control steps; distances are learned in units of T."""
        return episode_length(self.env)

    @property
    def learns_distance(self) -> bool:
        """Whether the method trains d (all but sparse)."""
        return self.method != "sparse"

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return json.loads(json.dumps(dataclasses.asdict(self)))

    def hash(self) -> str:
        """Short hash of everything but the seed: equal hashes ask the same question.

        Options added after results existed do not enter at the value that means what was done before.
        """
        asked = {
            k: v
            for k, v in self.to_dict().items()
            if k not in ("seed", *SPEED_ONLY) and (k not in ADDED or v != ADDED[k])
        }
        return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()[:10]


SPEED_ONLY = ("compiled",)
ADDED = {
    "agent": "sac",
    "action_noise": 0.2,
    "action_penalty": 1.0,
    "rescale": False,
    "matmul_precision": "highest",
    "other_goals_ratio": 0.0,
    "held_starts": 0.0,
    "clipped_double_q": False,
    "slow_distance": False,
    "first_arrival": False,
}
MANY, TINY = 10**9, 1e-12
RANGES: dict[str, tuple[float, float]] = {
    "seed": (0, 2**31 - 1),
    "n_episodes": (1, MANY),
    "n_warmup_episodes": (1, MANY),
    "episodes_per_iteration": (1, MANY),
    "n_temporal_updates": (0, MANY),
    "n_triangular_updates": (0, MANY),
    "n_policy_updates": (0, MANY),
    "batch_size": (1, MANY),
    "distance_learning_rate": (TINY, 1),
    "target_polyak": (TINY, 1),
    "uncertainty_scale": (TINY, MANY),  # C, M > 0 in eq. 2
    "uncertainty_power": (TINY, 100),
    "visit_bits": (1, 62),
    "reached_bits": (1, 62),
    "triangular_weight": (0, MANY),
    "ddl_window": (1, MANY),
    "relabel_ratio": (0, 1),
    "other_goals_ratio": (0, 1),
    "discount": (0, 1 - 1e-6),
    "policy_learning_rate": (TINY, 1),
    "polyak": (TINY, 1),
    "entropy_weight": (TINY, MANY),
    "min_entropy_weight": (TINY, MANY),
    "action_noise": (0, 100),
    "action_penalty": (0, MANY),
    "epsilon": (0, 1),
    "held_starts": (0, 1),
    "exploration_hold": (1, MANY),
    "evaluate_every": (1, MANY),
    "n_evaluation_episodes": (1, MANY),
}


def from_dict(values: dict[str, Any]) -> TrainConfig:
    """Rebuild a configuration from :meth:`TrainConfig.to_dict`.

    Raises:
        UserError: fields are unknown or of the wrong kind.
    """
    try:
        return TrainConfig(**values)
    except TypeError as error:
        raise UserError(f"configuration does not fit this version of napsp ({error}); retrain it") from None
