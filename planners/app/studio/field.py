"""The distance over a maze as a surface under its floor: a bowl whose bottom is the goal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planners.app.distance_field import DistanceField
from planners.app.maze_map import steps_field
from planners.app.session import Session

if TYPE_CHECKING:
    import viser  # pyright: ignore[reportMissingImports] - an extra

BINS = 48  # points per side
DEPTH = 0.6  # of the goal under the farthest place, as a share of the maze's half width
GAP = 0.02  # of the farthest place under the floor, in the same share


class Field:
    """Draws what the cost's estimate says, at rest, of every place; drawn anew when the goal is elsewhere."""

    drawable = staticmethod(DistanceField.drawable)

    def __init__(self, server: viser.ViserServer, session: Session) -> None:
        self._server, self._session = server, session
        self._scale = session.env.unwrapped.scale
        self._goal: np.ndarray | None = None

    def draw(self, goal: np.ndarray) -> None:
        """Show the field of steps to a goal ``(2,)``, metres."""
        if self._goal is not None and np.array_equal(goal, self._goal):
            return
        self._goal = goal.copy()
        steps = steps_field(self._session.controller.cost.to_go, self._scale, goal, BINS)
        vertices, faces, colors = surface(steps, self._scale)
        import trimesh  # pyright: ignore[reportMissingImports] - comes with viser

        mesh = trimesh.Trimesh(vertices, faces, vertex_colors=colors, process=False)
        self._server.scene.add_mesh_trimesh("/field", mesh, cast_shadow=False, receive_shadow=False)


def surface(steps: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices ``(B * B, 3)`` in metres, triangles ``(F, 3)`` and colours ``(B * B, 4)`` of a field ``(B, B)`` [y, x].

    Args:
        steps: to go; places from which none are known lie as high as the farthest.
        scale: half the maze's width, metres.
    """
    from matplotlib import colormaps

    bins = len(steps)
    finite = np.isfinite(steps)
    most = max(float(steps[finite].max()), 1e-9) if finite.any() else 1.0
    share = np.where(finite, steps, most) / most
    centres = (np.arange(bins) + 0.5) / bins * 2 * scale - scale
    x, y = np.meshgrid(centres, centres)
    vertices = np.stack([x, y, scale * (DEPTH * (share - 1.0) - GAP)], axis=-1).reshape(-1, 3)
    corner = (np.arange(bins - 1)[:, None] * bins + np.arange(bins - 1)).ravel()
    right, above, across = corner + 1, corner + bins, corner + bins + 1
    faces = np.concatenate([np.stack([corner, right, across], 1), np.stack([corner, across, above], 1)])
    colors = (255 * colormaps["viridis_r"](share.ravel())).astype(np.uint8)
    return vertices, faces, colors
