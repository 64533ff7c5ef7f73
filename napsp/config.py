"""Every choice of the method: one frozen dataclass that nests those of the parts; cards have the values per task.

The paper's appendix with hyper-parameters is not public, so each value here is ours;
``docs/paper.md`` gives the reason and the experiment behind it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import tyro

from napsp.data.collect import ExplorationConfig
from napsp.data.outcomes import EvaluationConfig
from napsp.distance.counts import CountConfig, UncertaintyConfig
from napsp.distance.graph import GraphConfig
from napsp.distance.labels import BootstrapConfig, TemporalConfig, TriangularConfig
from napsp.distance.losses import LOSSES
from napsp.distance.network import DistanceConfig
from napsp.envs import canonical_name, episode_length
from napsp.envs.cards import CARDS, Recipe
from napsp.errors import UserError, choose
from napsp.policy.agent import PolicyConfig
from napsp.policy.agents import AGENTS
from napsp.policy.her import HERConfig
from napsp.policy.qrl import QRLConfig
from napsp.settings import MANY, changed, check_choice, check_ranges, digest, flat, to_dict

PAPER_METHODS = ("sparse", "ddl", "offpolicy_ddl", "ours")
METHODS = (*PAPER_METHODS, "plus", "qrl")
PAPER = "paper"


def recipes(env: str) -> Mapping[str, Recipe]:
    """Recipes that a task can be trained by."""
    return {PAPER: Recipe({}), **(CARDS[env].recipes if env in CARDS else {})}


@dataclass(frozen=True)
class TrainConfig:
    """Options of Algorithm 1. Lengths are in control steps, distances in steps."""

    env: str = "fetch_wall"
    """Task: point_maze, point_maze_long, fetch_reach, fetch_wall, fetch_wall_high, fetch_pick_place,
    fetch_pick_place_wall or claw; a Gymnasium id such as FetchPush-v4, package:Id, or your own module:Class: any
    goal environment trains, see docs/goal_environments.md."""
    reached: str | None = None
    """Success test of a goal environment whose own reward is dense: a radius in units of its goal, or module:function,
    which maps achieved and desired goals (n, G) to bool (n,)."""
    method: str = "ours"
    """sparse: binary reward. ddl: on-policy temporal regression. offpolicy_ddl: eq. 4a.
    ours: eq. 4a and 4b (the paper). plus: beyond the paper, one pair of networks is distance and critic, with shortest
    paths over the replay as labels where they are known. qrl: quasimetric RL, a yardstick."""
    recipe: str = PAPER
    """paper: the method as it stands there. manipulation: what pick and place is learned with beyond the paper, see
    docs/paper.md; the options that it changes can still be set one by one."""
    seed: int = 0
    """Seed of everything random in the run."""

    n_episodes: Annotated[int, tyro.conf.arg(aliases=("--episodes",))] = 500
    """Training episodes in total, warm-up included; rounded up to whole iterations."""
    n_warmup_episodes: int = 20
    """Episodes of random actions that seed the buffer D and set the input scaling."""
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
    replay_capacity: int | None = None
    """Episodes that the replay D keeps, the oldest go first; None keeps all. Counts stay as they are, but for
    --rescale, which counts what D holds. Where there is a graph, D forgets when that is built anew."""
    hidden: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of every network."""
    rescale: bool = False
    """Estimate the input scaling anew each time D has doubled, not from the warm-up alone."""
    matmul_precision: Literal["highest", "medium"] = "highest"
    """torch's precision of float32 matrix products while training; medium lets processors with
    bfloat16 units multiply up to four times faster, with 8-bit mantissas and float32 sums."""

    distance: DistanceConfig = field(default_factory=DistanceConfig)
    temporal: TemporalConfig = field(default_factory=TemporalConfig)
    uncertainty: UncertaintyConfig = field(default_factory=UncertaintyConfig)
    counts: CountConfig = field(default_factory=CountConfig)
    triangular: TriangularConfig = field(default_factory=TriangularConfig)
    bootstrap: BootstrapConfig = field(default_factory=BootstrapConfig)
    graph: GraphConfig = field(default_factory=GraphConfig)
    qrl: QRLConfig = field(default_factory=QRLConfig)
    policy: PolicyConfig = field(default_factory=PolicyConfig)
    her: HERConfig = field(default_factory=HERConfig)
    explore: ExplorationConfig = field(default_factory=ExplorationConfig)
    evaluate: EvaluationConfig = field(default_factory=EvaluationConfig)

    def __post_init__(self) -> None:
        object.__setattr__(self, "env", canonical_name(self.env))
        object.__setattr__(self, "hidden", tuple(self.hidden))
        check_choice(self, method=METHODS, recipe=tuple(recipes(self.env)), matmul_precision=("highest", "medium"))
        check_choice(self.policy, agent=tuple(AGENTS))
        check_choice(self.distance, loss=tuple(LOSSES))
        at_least_one = ("n_episodes", "n_warmup_episodes", "episodes_per_iteration", "batch_size")
        updates = ("n_temporal_updates", "n_triangular_updates", "n_policy_updates")
        check_ranges(self, seed=(0, 2**31 - 1), **dict.fromkeys(at_least_one, (1, MANY)))
        check_ranges(self, replay_capacity=(1, MANY), **dict.fromkeys(updates, (0, MANY)))
        if self.jointly and self.policy.agent != "ddpg":
            raise UserError(f"method {self.method} has a deterministic policy of its own; leave out --policy.agent")
        if self.policy.slow and (self.policy.agent == "sac" or self.method == "qrl"):
            raise UserError("--policy.slow needs --policy.agent ddpg or --method plus: SAC and qrl keep no slow policy")
        if (self.method == "qrl") != (self.distance.head == "latent"):
            raise UserError("--distance.head latent belongs to --method qrl alone, and qrl has no other")
        if not self.hidden or min(self.hidden) < 1:
            raise UserError(f"hidden is {self.hidden}; give at least one width of at least 1")
        if self.replay_capacity is not None and self.replay_capacity < self.n_warmup:
            raise UserError(
                f"replay_capacity is {self.replay_capacity}; it must hold the {self.n_warmup} warm-up episodes at least"
            )
        if self.n_episodes <= self.n_warmup:
            raise UserError(f"n_episodes is {self.n_episodes}; it must exceed the {self.n_warmup} warm-up episodes")

    @property
    def n_warmup(self) -> int:
        """Warm-up episodes, rounded up to whole iterations."""
        return -(-self.n_warmup_episodes // self.episodes_per_iteration) * self.episodes_per_iteration

    @property
    def n_iterations(self) -> int:
        """Iterations of Algorithm 1, I: as many as the episodes after the warm-up need."""
        return -(-(self.n_episodes - self.n_warmup) // self.episodes_per_iteration)

    @property
    def episode_length(self) -> int:
        """T, control steps per episode; distances are learned in units of T."""
        return episode_length(self.env)

    @property
    def jointly(self) -> bool:
        """Whether distance and policy learn from the same samples: the policy descends d, there is no other critic."""
        return self.method in ("plus", "qrl")

    @property
    def learns_distance(self) -> bool:
        """Whether the method trains d (all but sparse)."""
        return self.method != "sparse"

    @property
    def lost_step(self) -> float:
        """Discounted return that a step more costs: 1 with the sparse reward; with -d / T every later reward has it."""
        if not self.learns_distance:
            return 1.0
        return 1.0 / (self.episode_length * (1.0 - self.policy.discount))

    def identity(self) -> dict[str, Any]:
        """What this run asks, the seed apart: its differences from the defaults, by dotted names."""
        return identity_of(to_dict(self))

    def digest(self) -> str:
        """Ten digits for :meth:`identity`, in file names."""
        return digest(self.identity())


DEFAULT = TrainConfig()
_USUAL = flat(to_dict(DEFAULT))
NO_DIFFERENCE = ("seed", "recipe")
"""Options that are no part of a question: a recipe is the values that it sets."""
OF_THE_GATE = ("counts.pair_bits", "counts.goal_cell", "counts.n_lattices")
"""How N(s, a, g) is counted, for which eq. 4b alone asks."""
OF_REGRESSION = ("temporal.", "triangular.", "n_temporal_updates", "n_triangular_updates", "policy.discount",
                 "policy.clip_values", "policy.clipped_double_q", "policy.entropy_weight",
                 "policy.min_entropy_weight")  # fmt: skip
"""Options, or beginnings of their names, for which only the paper's methods ask."""
OF_GRAPH = ("graph.", "explore.explorers", "explore.patience", "explore.anew", "explore.walk_hold")
"""For which plus asks, and qrl for the sake of its explorers."""


def idle_options(method: str) -> tuple[str, ...]:
    """Options, or beginnings of their names, for which a method does not ask."""
    if method == "plus":
        return (*OF_REGRESSION, "qrl.")
    if method == "qrl":
        return (*OF_REGRESSION, "bootstrap.", "distance.loss", "distance.target_polyak", "policy.polyak", "policy.slow")
    return (*OF_GRAPH, "bootstrap.", "qrl.")


def identity_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """What a stored configuration asks, as :meth:`TrainConfig.identity`: task, method, differences from the defaults.

    An option that ``values`` lack has today's default: whoever adds one chooses a default that leaves things as they
    were. One that is unknown today is a difference, so such a row is never taken for one of today's. What a method does
    not ask for is no difference.
    """
    usual, found = _USUAL, flat(values)
    for name, value in found.items():  # 1 is 1.0
        if isinstance(usual.get(name, ""), float | None) and isinstance(value, int) and not isinstance(value, bool):
            found[name] = float(value)
    different = {name: value for name, value in found.items() if name not in usual or usual[name] != value}
    task = {"env": found.get("env", DEFAULT.env), "method": found.get("method", DEFAULT.method)}
    idle = (*NO_DIFFERENCE, *(() if task["method"] == "ours" else OF_THE_GATE))
    idle += idle_options(task["method"])
    return {name: value for name, value in different.items() if not name.startswith(idle)} | task


PLUS: dict[str, Any] = {
    "hidden": (256, 256, 256),
    "episodes_per_iteration": 4,
    "n_temporal_updates": 0,
    "n_triangular_updates": 0,
    "n_policy_updates": 100,
    "distance.n_members": 2,
    "distance.unit": "step",
    "distance.loss": "relative",
    "distance.target_polyak": 0.005,
    "distance.slow": True,
    "policy.agent": "ddpg",
    "policy.polyak": 0.005,
    "policy.action_penalty": 0.02,
    "her.relabel_ratio": 0.4,
    "her.other_goals_ratio": 0.5,
    "explore.explorers": 0.5,
}
"""What method plus differs in from the defaults, on every task."""


QRL: dict[str, Any] = {
    "distance.head": "latent",
    "distance.slow": False,
    "distance.learning_rate": 1e-4,
    "policy.learning_rate": 3e-4,
    "policy.slow": False,
}
"""What method qrl differs in from plus: collection, sizes of layers and amounts of work are those of plus."""
JOINTLY: dict[str, dict[str, Any]] = {"plus": {}, "qrl": QRL}
"""Methods whose networks are distance and critic in one, and their differences from plus."""


def preset(
    env: str,
    method: str = "ours",
    recipe: str = PAPER,
    changes: Mapping[str, Any] | None = None,
    **overrides: Any,
) -> TrainConfig:
    """The default configuration of a task, method and recipe, with ``changes`` by dotted names.

    Raises:
        UserError: there is no such task, method, recipe or option.
    """
    env = canonical_name(env)
    values = dict(CARDS[env].training) if env in CARDS else {}
    chosen = recipes(env).get(recipe)
    if chosen is None:
        raise UserError(f"there is no recipe {recipe!r} for {env}; {choose(recipe, recipes(env))}")
    values |= chosen.changes
    if method != "sparse":
        values |= chosen.with_distance
    if method in JOINTLY:
        values |= PLUS | (dict(CARDS[env].plus) if env in CARDS else {}) | JOINTLY[method]
    values |= {"env": env, "method": method, "recipe": recipe, **(changes or {}), **overrides}
    return changed(DEFAULT, values)


def from_dict(values: Mapping[str, Any]) -> TrainConfig:
    """Rebuild a configuration from :func:`napsp.settings.to_dict`; options it does not name have their defaults.

    Raises:
        UserError: an option is unknown or of the wrong kind.
    """
    canonical_name(values.get("env", DEFAULT.env))  # of a task that is not at hand it says so
    try:
        return changed(DEFAULT, flat(values))
    except UserError as error:
        raise UserError(f"configuration does not fit this version of napsp ({error}); retrain it") from None


__all__ = [
    "DEFAULT", "METHODS", "PAPER", "PAPER_METHODS", "TrainConfig", "from_dict", "identity_of", "preset", "recipes",
    "to_dict",
]  # fmt: skip
