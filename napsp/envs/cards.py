"""One card per task: everything the package knows about it beside its physics.

A new task is one card here and one file with its physics. Values that a card does not name are the defaults of
:class:`napsp.config.TrainConfig` and of the planning commands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal


@dataclass(frozen=True)
class Planning:
    """What a task is planned with unless the user says otherwise.

    Attributes:
        horizon: H, control steps per plan.
        smoothing_multiples: how many times as heavily the smoothing layer weighs changes, one problem each.
        coarse_substeps: physics steps per control step of the coarse model; None is a quarter of the task's own.
        finest: noise of the last sample as a share of the first's, of MPPI and predictive sampling.
    """

    horizon: int = 8
    smoothing_multiples: tuple[float, ...] = (0.3, 1.0, 3.0, 10.0)
    coarse_substeps: int | None = None
    finest: float = 1.0


@dataclass(frozen=True)
class Recipe:
    """A named set of choices beyond the paper, see ``--recipe``.

    Attributes:
        changes: of the training configuration, by dotted names.
        with_distance: further ones, for methods that learn d.
    """

    changes: Mapping[str, Any]
    with_distance: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Card:
    """A task.

    Attributes:
        gym_id: its id in Gymnasium's registry.
        entry_point: ``module:Class`` of its environment.
        episode_length: T, control steps.
        kwargs: keyword arguments of the class.
        aliases: further names.
        n_effector: how many numbers at the start of an observation say where the end effector is (claw: its joints).
        training: differences from the default training configuration, by dotted names.
        plus: further ones for methods plus and qrl.
        recipes: named sets of choices beyond the paper.
        planning: what it is planned with.
        suite: the paper's tasks, harder ones, or variants that no table shows.
    """

    gym_id: str
    entry_point: str
    episode_length: int
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    aliases: tuple[str, ...] = ()
    n_effector: int = 3
    training: Mapping[str, Any] = field(default_factory=dict)
    plus: Mapping[str, Any] = field(default_factory=dict)
    recipes: Mapping[str, Recipe] = field(default_factory=dict)
    planning: Planning = Planning()
    suite: Literal["paper", "harder", "variant"] = "paper"


POINT = "napsp.envs.point_maze:PointMazeEnv"
REACH, REACH_WALL = "napsp.envs.fetch:FetchReachEnv", "napsp.envs.fetch:FetchReachWallEnv"
PICK, PICK_WALL = "napsp.envs.fetch_pick_place:FetchPickPlaceEnv", "napsp.envs.fetch_pick_place:FetchPickPlaceWallEnv"

MAZE_PLANNING = Planning(horizon=16, smoothing_multiples=(1.0,), coarse_substeps=5, finest=0.1)
REACH_PLANNING = Planning(horizon=5, coarse_substeps=5)
PICK_PLANNING = Planning(horizon=8, coarse_substeps=5)
PLAIN_PICK_PLANNING = Planning(horizon=15, coarse_substeps=5)

PICK_TRAINING: dict[str, Any] = {
    "n_episodes": 11_000,
    "n_warmup_episodes": 200,
    "episodes_per_iteration": 8,
    "rescale": True,
    "batch_size": 1024,
    "matmul_precision": "medium",
    "n_temporal_updates": 25,
    "n_triangular_updates": 12,
    "policy.agent": "ddpg",
    "policy.polyak": 0.005,
    "explore.epsilon": 0.3,
    "explore.hold": 1,
    "evaluate.every": 250,
    "evaluate.n_episodes": 50,
}
"""Pick and place: DDPG as in the paper, with amounts of work and exploration like HER's."""

# Measured in docs/plus.md, *Narrow networks* and *The mean of two*.
REACH_PLUS: dict[str, Any] = {"hidden": (64, 64, 64), "n_policy_updates": 400}
WALL_PLUS: dict[str, Any] = {**REACH_PLUS, "batch_size": 128}
WIDE_PICK_PLUS: dict[str, Any] = {"n_episodes": 4000, "episodes_per_iteration": 8, "n_policy_updates": 50}
PICK_PLUS: dict[str, Any] = {
    **WIDE_PICK_PLUS,
    "hidden": (128, 128, 128),
    "batch_size": 512,
    "n_policy_updates": 100,
    "bootstrap.pessimism": "mean",
}

MANIPULATION = Recipe(
    {
        "explore.held_starts": 0.5,
        "her.relabel_ratio": 0.4,
        "her.other_goals_ratio": 0.5,
        "distance.target_polyak": 0.05,
        "distance.slow": True,
        "policy.clipped_double_q": True,
        "policy.action_penalty": 0.02,
    },
    with_distance={"policy.discount": 0.9},  # how far the goal is stands in every reward: a short horizon will do
)
"""What pick and place is learned with beyond the paper: episodes that begin with the box in the gripper, goals of other
episodes, an averaged distance as reward, the smaller of two critics, and hardly a penalty on actions."""

RECIPES = {"manipulation": MANIPULATION}

CARDS: dict[str, Card] = {
    "point_maze": Card(
        "napsp/PointMaze-v0",
        POINT,
        50,
        n_effector=2,
        training={"n_episodes": 1000, "episodes_per_iteration": 4, "evaluate.every": 100},
        planning=MAZE_PLANNING,
    ),
    "point_maze_long": Card(
        "napsp/PointMazeLong-v0",
        POINT,
        200,
        {"scale": 4.0},
        n_effector=2,
        plus={"n_policy_updates": 400, "graph.n_goals": 6000, "explore.walk_hold": 24, "policy.slow": True},
        training={
            "n_episodes": 600,
            "episodes_per_iteration": 4,
            "n_policy_updates": 100,
            "uncertainty.scale": 40.0,
            # The paper's epsilon exploration: even sparse crosses the house with held actions. Walkers of plus hold.
            "explore.hold": 1,
            "explore.epsilon": 0.3,
            "evaluate.every": 100,
        },
        planning=MAZE_PLANNING,
        suite="harder",
    ),
    "fetch_reach": Card(
        "napsp/FetchReach-v0",
        REACH,
        50,
        plus=REACH_PLUS,
        training={"n_episodes": 400, "evaluate.every": 20, "counts.visit_bits": 12, "policy.learning_rate": 3e-4},
        planning=REACH_PLANNING,
    ),
    "fetch_wall": Card(
        "napsp/FetchReachWall-v0",
        REACH_WALL,
        50,
        aliases=("fetch_reach_wall",),
        plus=WALL_PLUS,
        training={"n_episodes": 500},
        planning=REACH_PLANNING,
    ),
    "fetch_wall_high": Card(
        "napsp/FetchReachWallHigh-v0",
        REACH_WALL,
        50,
        {"wall_height": 0.4},
        plus=WALL_PLUS,
        training={"n_episodes": 1000, "evaluate.every": 100},
        planning=REACH_PLANNING,
        suite="harder",
    ),
    "fetch_pick_place": Card(
        "napsp/FetchPickPlace-v0",
        PICK,
        50,
        aliases=("fetch_pick_and_place",),
        training=PICK_TRAINING,
        plus=PICK_PLUS,
        recipes=RECIPES,
        planning=PICK_PLANNING,
    ),
    "fetch_pick_place_wall": Card(
        "napsp/FetchPickPlaceWall-v0",
        PICK_WALL,
        50,
        aliases=("fetch_pick_and_place_wall", "pick_place_wall"),
        training={**PICK_TRAINING, "counts.goal_cell": 0.1},  # goals spread over both sides; a radius is less of that
        plus=WIDE_PICK_PLUS,
        recipes=RECIPES,
        planning=PICK_PLANNING,
    ),
    "claw": Card(
        "napsp/Claw-v0",
        "napsp.envs.claw:ClawEnv",
        40,
        n_effector=9,
        training={"n_episodes": 3000},
        planning=Planning(horizon=10, coarse_substeps=20),
    ),
    # Pick and place with the box's position alone as the goal, as in stock Fetch.
    "fetch_pick_place_plain": Card(
        "napsp/FetchPickPlacePlain-v0",
        PICK,
        50,
        {"augmented_goal": False},
        training={**PICK_TRAINING, "counts.goal_cell": 0.22},  # the box alone: random play hardly moves it
        plus=WIDE_PICK_PLUS,
        recipes=RECIPES,
        planning=PLAIN_PICK_PLANNING,
        suite="variant",
    ),
    "fetch_pick_place_wall_plain": Card(
        "napsp/FetchPickPlaceWallPlain-v0",
        PICK_WALL,
        50,
        {"augmented_goal": False},
        training=PICK_TRAINING,
        plus=WIDE_PICK_PLUS,
        recipes=RECIPES,
        planning=PLAIN_PICK_PLANNING,
        suite="variant",
    ),
}

UNKNOWN = Planning()
"""How a task without a card is planned."""


def suite(name: str) -> tuple[str, ...]:
    """Names of the tasks of a suite, in the order of the cards."""
    return tuple(task for task, card in CARDS.items() if card.suite == name)
