"""True shortest paths of the point maze: the cost that a learned distance should approach."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra

N_CELLS = 120  # per side


class ShortestPaths:
    """Shortest collision-free steps between places of a square arena with box obstacles.

    The point moves along both axes at once, so a diagonal neighbour is as near as a straight
    one: shortest paths over the eight neighbours of grid cells are exact up to the cells' size.
    Speeding up is not counted.

    Args:
        half_size: the arena is [-half_size, half_size]^2, metres.
        boxes: obstacles, inflated by the point's radius: centre x, y, half length x, y ``(B, 4)``.
        step_length: metres per control step along one axis at full speed.
    """

    def __init__(self, half_size: float, boxes: np.ndarray, step_length: float) -> None:
        self._half_size, self._cell = half_size, 2.0 * half_size / N_CELLS
        self._steps_per_cell = self._cell / step_length
        centres = (np.arange(N_CELLS) + 0.5) * self._cell - half_size
        x, y = np.meshgrid(centres, centres, indexing="ij")
        blocked = np.zeros(x.shape, bool)
        for centre_x, centre_y, half_x, half_y in boxes:
            blocked |= (np.abs(x - centre_x) < half_x) & (np.abs(y - centre_y) < half_y)
        self._graph = _graph(~blocked)
        # Contact lets the point a little into the inflated walls: it counts as the nearest free cell.
        self._nearest = np.asarray(distance_transform_edt(blocked, return_distances=False, return_indices=True))
        self._goal, self._field = np.empty(0), np.empty(0)

    def steps(self, positions: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Steps ``(...)`` from positions ``(..., 2)`` to one goal ``(2,)``; +inf where there is no way."""
        if not np.array_equal(goal, self._goal):
            cells = dijkstra(self._graph, indices=int(self._index(goal)), unweighted=True)
            self._goal, self._field = np.array(goal), cells * self._steps_per_cell
        straight = np.abs(positions - goal).max(-1) / (self._cell / self._steps_per_cell)
        # Within a cell or two of the goal the grid is coarser than the straight line.
        field = self._field[self._index(positions)]
        return np.where(field <= 2.0 * self._steps_per_cell, straight, field)

    def _index(self, positions: np.ndarray) -> np.ndarray:
        cells = np.floor((np.asarray(positions) + self._half_size) / self._cell).astype(int)
        i, j = np.moveaxis(np.clip(cells, 0, N_CELLS - 1), -1, 0)
        return self._nearest[0][i, j] * N_CELLS + self._nearest[1][i, j]


def _graph(free: np.ndarray) -> csr_matrix:
    """Edges between free cells ``(n, n)`` and their free neighbours, as a sparse matrix."""
    numbers = np.arange(free.size).reshape(free.shape)
    starts, ends = [], []
    for di, dj in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = np.s_[: -di or None, max(0, -dj) : -dj if dj > 0 else None]
        there = np.s_[di:, max(0, dj) : dj if dj < 0 else None]
        both = free[here] & free[there]
        starts.append(numbers[here][both])
        ends.append(numbers[there][both])
    rows, columns = np.concatenate(starts + ends), np.concatenate(ends + starts)
    return csr_matrix(coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(free.size, free.size)))
