"""How far from a goal, in units that mean something for the task: metres, or degrees where the goal is an angle."""

from __future__ import annotations

from typing import Any

import numpy as np


def world_gap(world: Any, gaps: np.ndarray) -> tuple[np.ndarray, str]:
    """Straight lines in the world, in metres, as they are shown to people.

    Args:
        world: the unwrapped environment; where its goals are angles, ``goal_circle`` is the radius [m] of the circle
            that ``goal_positions`` puts them on; where nobody knows the unit of its goals, its ``goal_unit`` is empty.
        gaps: any shape.

    Returns:
        The same in centimetres or degrees, and that unit; as they are, without one, where nobody knows it.
    """
    if getattr(world, "goal_unit", None) == "":
        return np.asarray(gaps), ""
    circle = getattr(world, "goal_circle", None)
    return (100.0 * np.asarray(gaps), "cm") if circle is None else (_degrees(gaps, circle), "deg")


def goal_gap(world: Any, gaps: np.ndarray) -> tuple[np.ndarray, str]:
    """The same for gaps between goals in their own coordinates; the unit is empty where nobody knows theirs."""
    if getattr(world, "goal_circle", None) is not None:
        return _degrees(gaps, 1.0), "deg"  # sine and cosine lie on the unit circle
    return np.asarray(gaps), getattr(world, "goal_unit", "m") if hasattr(world, "goal_positions") else ""


def _degrees(chords: np.ndarray, radius: float) -> np.ndarray:
    return np.degrees(2.0 * np.arcsin(np.clip(np.asarray(chords) / (2.0 * radius), 0.0, 1.0)))
