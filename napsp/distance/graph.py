"""Shortest paths over the replay: all pairs, literally. Beyond the paper.

Achieved goals are sorted into cells. Every observed transition that crosses from cell u to cell v is an edge, and a
path along such edges is what somebody could do, whoever did its parts: the triangle of eq. 4b for all waypoints at
once. An edge costs one step, or more if its cells are farther apart than the fastest come in one: paths may go on from
anywhere in a cell, and would gain up to its width with every step. Walls thinner than a cell, and what the achieved
goal does not show, are beyond it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from napsp.data.episodes import Episodes
from napsp.settings import MANY, check_ranges

FASTEST = 0.995
"""Quantile of changes of the achieved goal per step that is the fastest, by parts."""
LARGEST = 2.0**62
GROWTH = (1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5)


@dataclass(frozen=True)
class GraphConfig:
    """Labels of shortest paths over cells of achieved goals; for method plus."""

    every: int = 10
    """Iterations from one graph to the next; 0 goes without."""
    cell: float = 1.1
    """Least edge of a cell, in root mean square changes of the achieved goal per step."""
    growth: float = 3.0
    """Cells grow up to this many times until they hold ``occupancy`` states each; else there is no graph."""
    occupancy: int = 20
    """States per occupied cell, in the mean."""
    n_goals: int = 1500
    """Cells, drawn at random, to which paths are searched; all where there are no more."""
    luck: float = 0.01
    """A crossing from cell to cell is luck, and no edge, if fewer than this share of the ways out are such."""
    n_lattices: int = 3
    """Lattices of cells, shifted against each other; steps are the mean of theirs."""
    control: float = 0.3
    """No graph where actions explain less than this share of how some part of the achieved goal changes in random play:
    cells cannot tell states apart whose ways on depend on what the achieved goal does not show."""

    def __post_init__(self) -> None:
        check_ranges(self, every=(0, MANY), cell=(1e-3, 100), growth=(1, GROWTH[-1]), luck=(0, 1), control=(0, 1))
        check_ranges(self, occupancy=(1, MANY), n_goals=(1, MANY), n_lattices=(1, 100))


def control(episodes: Episodes) -> float:
    """How far actions decide at once how the achieved goal changes: the least share explained (R^2) of its parts.

    Linear regression of phi(s_t+1) - phi(s_t) on a_t over random play; parts that never change do not count. A valve
    that fingers push or a box out of reach have about 0, positions of a point or a gripper .4 to .99.
    """
    change = np.diff(episodes.achieved_goals.astype(np.float64), axis=1).reshape(-1, episodes.achieved_goals.shape[-1])
    actions = episodes.actions.reshape(-1, episodes.actions.shape[-1]).astype(np.float64)
    inputs = np.concatenate([actions, np.ones((len(actions), 1))], axis=1)
    rest = change - inputs @ np.linalg.lstsq(inputs, change, rcond=None)[0]
    moving = change.std(0) > 1e-9
    return float((1.0 - rest.var(0)[moving] / change.var(0)[moving]).min(initial=1.0)) if moving.any() else 0.0


class ReplayGraph:
    """Steps between achieved goals, from the transitions of D: the mean over lattices of cells that are shifted against
    each other, so that it changes more evenly than from cell to cell.

    Attributes:
        n_cells: occupied cells of the first lattice; 0 while the data is too sparse for a graph.
        connected: share of pairs of cells with an observed path.
        built_at: episodes that it was built from.
    """

    def __init__(self, config: GraphConfig) -> None:
        self._config, self.built_at = config, 0
        self._lattices: list[Lattice] = []

    @property
    def n_cells(self) -> int:
        """See the class."""
        return self._lattices[0].n_cells if self._lattices else 0

    @property
    def connected(self) -> float:
        """See the class."""
        return float(np.mean([lattice.connected for lattice in self._lattices])) if self._lattices else 0.0

    def build(self, episodes: Episodes, seed: int) -> None:
        """Search all paths anew; the same episodes and seed give the same graph."""
        config, self.built_at = self._config, len(episodes)
        rng = np.random.default_rng([seed, len(episodes)])
        shifts = np.arange(config.n_lattices) / config.n_lattices
        made = [Lattice.of(episodes, config, shift) for shift in shifts]
        self._lattices = [lattice for lattice in made if lattice is not None]
        for lattice in self._lattices:
            lattice.search(episodes, config, rng)

    def steps(self, achieved: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Steps ``(n,)`` of the shortest observed path between achieved goals and goals ``(n, G)``; NaN where unknown.

        Unknown are, in any lattice, cells that nobody visited, pairs without a path, cells to which none was searched.
        """
        found = [lattice.steps(achieved, goals) for lattice in self._lattices]
        return np.mean(found, axis=0) if found else np.full(len(goals), np.nan, np.float32)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """An achieved goal ``(G,)`` of D: one of a cell, and all cells as likely."""
        return self._lattices[0].draw(rng)


class Lattice:
    """Cells of achieved goals and the shortest paths between them.

    Args:
        episodes: whose achieved goals are sorted.
        edge: of a cell ``(G,)``.
        shift: of the lattice, in edges.

    Attributes:
        n_cells: occupied ones.
        connected: share of pairs with an observed path.
    """

    def __init__(self, episodes: Episodes, edge: np.ndarray, shift: float) -> None:
        self._places = episodes.achieved_goals.reshape(-1, len(edge))
        low, high = self._places.min(0).astype(np.float64), self._places.max(0)
        self._edge, self._low = edge, low - shift * edge
        self._shape = np.floor((high - low) / edge).astype(np.int64) + 2
        if np.prod(self._shape.astype(float)) > LARGEST:
            self.n_cells, self.connected = len(self._places), 0.0
            return
        codes = _codes(np.floor((self._places - self._low) / edge), self._shape)
        self._codes, self._cells = np.unique(codes, return_inverse=True)
        self.n_cells, self.connected = len(self._codes), 0.0

    @classmethod
    def of(cls, episodes: Episodes, config: GraphConfig, shift: float) -> Lattice | None:
        """The finest one with states enough in its cells; None where all would be too empty."""
        change = np.diff(episodes.achieved_goals.astype(np.float64), axis=1)
        least = config.cell * np.sqrt((change**2).mean((0, 1)))
        never = 1e-9 + 1e-6 * np.ptp(episodes.achieved_goals, axis=(0, 1))  # what never moves is one cell
        for growth in GROWTH:
            if growth <= config.growth:
                lattice = cls(episodes, np.maximum(least * growth, never), shift)
                if len(lattice._places) >= config.occupancy * lattice.n_cells:
                    return lattice
        return None

    def search(self, episodes: Episodes, config: GraphConfig, rng: np.random.Generator) -> None:
        """Dijkstra from all cells, or some, along observed crossings turned round."""
        n, cells = self.n_cells, self._cells.reshape(episodes.achieved_goals.shape[:2])
        start, end = cells[:, :-1].ravel(), cells[:, 1:].ravel()
        crossing = start != end
        edges, seen = np.unique(start[crossing] * n + end[crossing], return_counts=True)
        start, end = edges // n, edges % n
        usual = seen >= config.luck * np.bincount(start, seen, minlength=n)[start]
        start, end = start[usual], end[usual]
        change = np.abs(np.diff(episodes.achieved_goals, axis=1)).reshape(-1, len(self._edge))
        fastest = np.maximum(np.quantile(change, FASTEST, axis=0), 1e-12)
        leaps = self._edge * np.abs(_places(self._codes[end], self._shape) - _places(self._codes[start], self._shape))
        backwards = csr_matrix((np.maximum(1.0, (leaps / fastest).max(1, initial=0.0)), (end, start)), shape=(n, n))
        goals = np.arange(n) if n <= config.n_goals else rng.choice(n, config.n_goals, replace=False)
        self._steps = dijkstra(backwards, indices=goals).astype(np.float32)
        self._row = np.full(n, -1)
        self._row[goals] = np.arange(len(goals))
        self.connected = float(np.isfinite(self._steps).mean())

    def steps(self, achieved: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """As :meth:`ReplayGraph.steps`."""
        found = np.full(len(goals), np.nan, np.float32)
        here, there = self.cell(achieved), self.cell(goals)
        known = (here >= 0) & (there >= 0)
        known[known] = self._row[there[known]] >= 0
        steps = self._steps[self._row[there[known]], here[known]]
        steps[np.isinf(steps)] = np.nan
        found[known] = steps
        return found

    def cell(self, goals: np.ndarray) -> np.ndarray:
        """Number of the cell of goals ``(n, G)``; -1 where nobody was."""
        place = np.floor((goals - self._low) / self._edge)
        inside = np.all((place >= 0) & (place < self._shape), axis=-1)
        code = _codes(np.where(inside[:, None], place, 0), self._shape)
        found = np.searchsorted(self._codes, code)
        found[found == len(self._codes)] = 0
        return np.where(inside & (self._codes[found] == code), found, -1)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """As :meth:`ReplayGraph.draw`."""
        members = np.flatnonzero(self._cells == rng.integers(self.n_cells))
        return self._places[rng.choice(members)]


def _codes(places: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """One number for each cell ``(n, G)`` of a grid."""
    return np.asarray(np.ravel_multi_index(tuple(places.astype(np.int64).T), tuple(int(n) for n in shape)))


def _places(codes: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Cells ``(n, G)`` by their numbers."""
    return np.stack(np.unravel_index(codes, tuple(int(n) for n in shape)), axis=-1)
