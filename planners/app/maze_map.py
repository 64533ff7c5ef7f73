"""The maze from above: a field of steps to one goal over it, and its walls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from napsp.envs.point_maze import INNER_WALLS, OUTER_WALLS, WALL_HALF_THICKNESS

BINS = 60  # points per side


def at_rest(scale: float, bins: int = BINS) -> np.ndarray:
    """Observations ``(bins * bins, 4)`` of the point at rest, row by row from below."""
    centres = (np.arange(bins) + 0.5) / bins * 2 * scale - scale
    x, y = np.meshgrid(centres, centres)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size), np.zeros(x.size)], axis=1)


def steps_field(steps_to_go: Callable[..., np.ndarray], scale: float, goal: np.ndarray, bins: int = BINS) -> np.ndarray:
    """Steps ``(bins, bins)`` [y, x] from every place to a goal ``(2,)``; a learned d asks its policy for the action.

    Args:
        steps_to_go: a :class:`mpc.cost.StepsToGo`.
        scale: the maze's.
        goal: place in the maze, metres.
        bins: points per side.
    """
    observations = at_rest(scale, bins)
    return steps_to_go(observations, observations[:, :2], None, goal).reshape(bins, bins)


def draw_field(axis: Any, field: np.ndarray, scale: float, colours: str = "viridis_r") -> Any:
    """Draw a field ``(bins, bins)`` [y, x] under the walls; return the image, for a colour bar."""
    image = axis.imshow(field, origin="lower", extent=[-scale, scale] * 2, cmap=colours)
    draw_walls(axis, scale)
    return image


def wall_boxes(scale: float) -> np.ndarray:
    """Centres and half sizes ``(n, 4)``: x, y, half x, half y, metres."""
    x, y, half_x, half_y = scale * np.array(INNER_WALLS + OUTER_WALLS).T
    return np.stack([x, y, half_x + WALL_HALF_THICKNESS, half_y + WALL_HALF_THICKNESS], axis=1)


def in_walls(positions: np.ndarray, scale: float) -> np.ndarray:
    """Whether places ``(n, 2)`` are inside a wall."""
    x, y, half_x, half_y = wall_boxes(scale)[:, :, None].transpose(1, 0, 2)
    return ((np.abs(positions[:, 0] - x) < half_x) & (np.abs(positions[:, 1] - y) < half_y)).any(0)


def draw_walls(axis: Any, scale: float) -> None:
    """The walls of the house as black boxes."""
    from matplotlib.patches import Rectangle

    for x, y, half_x, half_y in wall_boxes(scale):
        axis.add_patch(Rectangle((x - half_x, y - half_y), 2 * half_x, 2 * half_y, color="black"))
    axis.set(
        xticks=[], yticks=[], aspect="equal", xlim=(-1.05 * scale, 1.05 * scale), ylim=(-1.05 * scale, 1.05 * scale)
    )
