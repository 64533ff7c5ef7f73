"""The configurations that each task is trained with by default."""

from __future__ import annotations

from typing import Any

from napsp.config import TrainConfig
from napsp.envs import canonical_name

PICK_PLACE: dict[str, Any] = {
    "n_episodes": 11_000,
    "n_warmup_episodes": 200,
    "episodes_per_iteration": 8,
    "rescale": True,
    "agent": "ddpg",
    "batch_size": 1024,
    "matmul_precision": "medium",
    "n_temporal_updates": 25,
    "n_triangular_updates": 12,
    "target_polyak": 0.05,
    "slow_distance": True,
    "polyak": 0.005,
    "action_penalty": 0.02,
    "clipped_double_q": True,
    "relabel_ratio": 0.4,
    "other_goals_ratio": 0.5,
    "held_starts": 0.5,
    "epsilon": 0.3,
    "exploration_hold": 1,
    "evaluate_every": 250,
    "n_evaluation_episodes": 50,
}
PRESETS: dict[str, dict[str, Any]] = {
    "point_maze": {"n_episodes": 1000, "episodes_per_iteration": 4, "evaluate_every": 100},
    "point_maze_long": {
        "n_episodes": 600,
        "episodes_per_iteration": 4,
        "evaluate_every": 100,
        "uncertainty_scale": 40.0,
        "n_policy_updates": 100,
        "exploration_hold": 1,  # the paper's epsilon exploration: with held actions even sparse crosses the house
        "epsilon": 0.3,
    },
    "fetch_reach": {
        "n_episodes": 400,
        "evaluate_every": 20,
        "visit_bits": 12,
        "policy_learning_rate": 3e-4,
    },
    "fetch_wall": {"n_episodes": 500},
    "fetch_wall_high": {"n_episodes": 1000, "evaluate_every": 100},
    "fetch_pick_place": PICK_PLACE,
    "fetch_pick_place_wall": PICK_PLACE,
    "fetch_pick_place_plain": PICK_PLACE,
    "fetch_pick_place_wall_plain": PICK_PLACE,
    "claw": {"n_episodes": 3000},
}


WITH_DISTANCE: dict[str, dict[str, Any]] = {name: {"discount": 0.9} for name, p in PRESETS.items() if p is PICK_PLACE}
"""What differs for methods that learn d: how far the goal is stands in every reward, so a short horizon will do."""


def preset(env: str, method: str = "ours", **overrides: Any) -> TrainConfig:
    """The default configuration of a task and method."""
    env = canonical_name(env)
    values = {"env": env, "method": method, **PRESETS.get(env, {})}
    if method != "sparse":
        values |= WITH_DISTANCE.get(env, {})
    return TrainConfig(**{**values, **overrides})
