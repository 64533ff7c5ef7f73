"""Exact shortest paths in the point maze, in control steps, by search over the real dynamics."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from napsp.envs.point_maze import PointMazeEnv

ACTIONS = np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])


class MazeSearch:
    """Breadth-first search whose edges are MuJoCo control steps.

    States are sorted into cells of position and velocity; a cell keeps the first state that
    entered it, exactly as simulated, so every distance found is that of a real motion. It is
    an upper bound that falls to the truth as the cells shrink. Cells have to be smaller than a step, or they keep who
    enters them back: with cells of .16 m for steps of .1 m the ways of the long maze came out half as long again.

    Args:
        world: the maze.
        position_cell: edge of a position cell, in steps at full speed. .4 is 1 % above .2, .8 2.6 %.
        n_speeds: velocity cells per axis.
        tolerance: a goal counts as reached within this radius, in units of the scale.
    """

    def __init__(
        self, world: PointMazeEnv, position_cell: float = 0.4, n_speeds: int = 5, tolerance: float = 0.05
    ) -> None:
        self._world, self._model = world, world.model
        self._cell, self._n_speeds = position_cell * world.step_length, n_speeds
        self._tolerance = tolerance * world.scale
        self._datas = [mujoco.MjData(world.model) for _ in range(2)]
        self._pool = Rollout(nthread=2)

    def step(self, states: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Advance states ``(B, 4)`` by one control step with actions ``(B, 2)``."""
        start = np.concatenate([np.zeros((len(states), 1)), states], axis=1)
        held = np.repeat(actions[:, None], self._world.dynamics.substeps, axis=1)
        ends, _ = self._pool.rollout(self._model, self._datas, start, held)
        return np.asarray(ends)[:, -1, 1:5]

    def steps_to(self, state: np.ndarray, goals: np.ndarray, limit: int = 400) -> np.ndarray:
        """Steps from ``state`` ``(4,)`` to each goal ``(M, 2)``; inf where the search never came."""
        steps = np.full(len(goals), np.inf)
        frontier = state[None]
        seen = {int(key) for key in self._keys(frontier)}
        for depth in range(limit):
            gaps = np.linalg.norm(frontier[:, None, :2] - goals[None], axis=-1).min(0)
            steps[(gaps < self._tolerance) & np.isinf(steps)] = depth
            if np.isfinite(steps).all():
                break
            following = self.step(np.repeat(frontier, len(ACTIONS), axis=0), np.tile(ACTIONS, (len(frontier), 1)))
            keys, first = np.unique(self._keys(following), return_index=True)
            new = [i for key, i in zip(keys.tolist(), first.tolist(), strict=True) if key not in seen]
            seen.update(keys.tolist())
            if not new:
                break
            frontier = following[new]
        return steps

    def _keys(self, states: np.ndarray) -> np.ndarray:
        position = np.floor(states[:, :2] / self._cell).astype(np.int64) + 1000  # of 4000: mazes to 80 m
        # Speeds lie in [-1, 1] m/s.
        speed = np.clip(((states[:, 2:] + 1.0) / 2.0 * self._n_speeds).astype(np.int64), 0, self._n_speeds - 1)
        return ((position[:, 0] * 4000 + position[:, 1]) * self._n_speeds + speed[:, 0]) * self._n_speeds + speed[:, 1]

    def close(self) -> None:
        """Stop the worker threads."""
        self._pool.close()
