"""Trainings of a second."""

from napsp.config import preset

TINY = {
    "n_episodes": 16,
    "n_warmup_episodes": 4,
    "episodes_per_iteration": 2,
    "n_temporal_updates": 3,
    "n_triangular_updates": 2,
    "n_policy_updates": 3,
    "batch_size": 32,
    "hidden": (16, 16),
    "evaluate.every": 4,
    "evaluate.n_episodes": 2,
}


def tiny(env="point_maze", method="ours", recipe="paper", **changes):
    return preset(env, method, recipe, {**TINY, **changes})


def learned(rows):
    """Rows without what depends on the clock."""
    clock = {"seconds", "steps_per_second", "minutes_left"}
    return [{k: v for k, v in row.items() if k not in clock} for row in rows]
