"""Dragging a goal: which goal of a task is meant by a place in the world."""

from __future__ import annotations

from typing import Any

import numpy as np


def free_axes(world: Any, goal: np.ndarray) -> tuple[bool, bool, bool] | None:
    """Along which axes of the world a goal ``(G,)`` can be dragged; None where no place says which goal is meant."""
    n = min(3, len(goal))
    here = world.goal_positions(goal)
    for axis in range(3):
        moved = goal.copy()
        if axis < n:
            moved[axis] += 0.1
        expected = here + (0.1 * np.eye(3)[axis] if axis < n else 0.0)
        if not np.allclose(world.goal_positions(moved), expected):
            return (True, True, False) if _is_direction(goal) else None
    return n > 0, n > 1, n > 2


def goal_at(world: Any, goal: np.ndarray, place: np.ndarray) -> np.ndarray:
    """The goal ``(G,)`` that a place ``(3,)`` means; what a place does not say stays as in ``goal``.

    Fetch's goals begin with the place, a maze's are one. Those of the claw are a direction: the nearest is taken.
    """
    found = np.array(goal, float)
    n = min(3, len(goal))
    moved = found.copy()
    moved[:n] += place[:n] - world.goal_positions(goal)[:n]
    if np.allclose(world.goal_positions(moved)[:n], place[:n]):
        return moved
    if _is_direction(goal) and np.linalg.norm(place[:2]) > 0:
        angles = np.linspace(-np.pi, np.pi, 721)
        goals = np.stack([np.sin(angles), np.cos(angles)], axis=1)
        return goals[np.linalg.norm(world.goal_positions(goals) - place, axis=1).argmin()]
    return found


def _is_direction(goal: np.ndarray) -> bool:
    return len(goal) == 2 and bool(np.isclose(np.linalg.norm(goal), 1.0))
