"""Figures in units that mean something for the task: metres, and of the claw, whose goals lie on a circle, degrees."""

from __future__ import annotations

import math


def unit(env: str) -> str:
    """What distances to a goal of a task are given in."""
    return "°" if env == "claw" else "m"


def in_unit(env: str, column: str, value: float) -> float:
    """A figure of a training by its column; distances to a goal, the claw's as chords of a circle, in :func:`unit`."""
    if column != "max_reward" or unit(env) == "m":
        return value
    return math.degrees(2.0 * math.asin(max(-2.0, min(2.0, value)) / 2.0))
