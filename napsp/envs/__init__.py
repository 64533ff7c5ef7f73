"""The tasks: short names, Gymnasium registration and :func:`make`."""

from __future__ import annotations

from typing import Any

import farama_notifications

# gymnasium-robotics prints a notice about its Adroit tasks on import; no task here is one.
farama_notifications.notifications.pop("gymnasium_robotics", None)

import gymnasium  # noqa: E402

from napsp.errors import UserError  # noqa: E402

TASKS: dict[str, tuple[str, str, dict, int]] = {
    # name: (Gymnasium id, entry point, keyword arguments, episode length in control steps)
    "point_maze": ("napsp/PointMaze-v0", "napsp.envs.point_maze:PointMazeEnv", {}, 50),
    "point_maze_long": ("napsp/PointMazeLong-v0", "napsp.envs.point_maze:PointMazeEnv", {"scale": 4.0}, 200),
    "fetch_reach": ("napsp/FetchReach-v0", "napsp.envs.fetch:FetchReachEnv", {}, 50),
    "fetch_wall": ("napsp/FetchReachWall-v0", "napsp.envs.fetch:FetchReachWallEnv", {}, 50),
    "fetch_pick_place": ("napsp/FetchPickPlace-v0", "napsp.envs.fetch_pick_place:FetchPickPlaceEnv", {}, 50),
    "fetch_pick_place_wall": (
        "napsp/FetchPickPlaceWall-v0",
        "napsp.envs.fetch_pick_place:FetchPickPlaceWallEnv",
        {},
        50,
    ),
    "claw": ("napsp/Claw-v0", "napsp.envs.claw:ClawEnv", {}, 40),
    # Pick and place with the box's position alone as the goal, as in stock Fetch.
    "fetch_pick_place_plain": (
        "napsp/FetchPickPlacePlain-v0",
        "napsp.envs.fetch_pick_place:FetchPickPlaceEnv",
        {"augmented_goal": False},
        50,
    ),
    "fetch_pick_place_wall_plain": (
        "napsp/FetchPickPlaceWallPlain-v0",
        "napsp.envs.fetch_pick_place:FetchPickPlaceWallEnv",
        {"augmented_goal": False},
        50,
    ),
}
ALIASES = {
    "fetch_reach_wall": "fetch_wall",
    "fetch_pick_and_place": "fetch_pick_place",
    "fetch_pick_and_place_wall": "fetch_pick_place_wall",
    "pick_place_wall": "fetch_pick_place_wall",
}


def canonical_name(name: str) -> str:
    """Resolve an alias or a Gymnasium id to a task name.

    Raises:
        UserError: the name is unknown; the message lists the known ones.
    """
    by_id = {task[0]: short for short, task in TASKS.items()}
    name = ALIASES.get(name, by_id.get(name, name))
    if name not in TASKS:
        known = ", ".join([*TASKS, *ALIASES])
        raise UserError(f"unknown environment {name!r}; choose one of: {known}")
    return name


def episode_length(name: str) -> int:
    """Control steps per episode of a task."""
    return TASKS[canonical_name(name)][3]


def make(name: str, **kwargs: Any) -> gymnasium.Env:
    """Create a task by short name, alias or Gymnasium id, with its time limit."""
    return gymnasium.make(TASKS[canonical_name(name)][0], **kwargs)


def register_all() -> None:
    """Register every task with Gymnasium (done once, on import)."""
    for gym_id, entry_point, kwargs, steps in TASKS.values():
        if gym_id not in gymnasium.registry:
            gymnasium.register(gym_id, entry_point=entry_point, kwargs=kwargs, max_episode_steps=steps)


register_all()
