"""Shortest paths over the replay: all pairs, literally. Beyond the paper.

Achieved goals are sorted into cells. Every observed transition that crosses from cell u to cell v is an edge, and a
path along such edges is what somebody could do, whoever did its parts: the triangle of eq. 4b for all waypoints at
once. An edge costs one step, or more if its cells are farther apart than the fastest come in one: paths may go on from
anywhere in a cell, and would gain up to its width with every step. A goal is reached in every cell that the task's own
success test accepts for it. Walls thinner than a cell, and what the achieved goal does not show, are beyond it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from napsp.data.episodes import Episodes, SparseReward
from napsp.settings import MANY, check_ranges

FASTEST = 0.995
"""Quantile of the changes of the achieved goal per step, by parts, zeros apart, that is the fastest."""
LARGEST = 2.0**62  # cells of a grid that int64 can number
GROWTH = (1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5)


@dataclass(frozen=True)
class GraphConfig:
    """Labels of shortest paths over cells of achieved goals; for method plus."""

    every: int = 10
    """Iterations from one graph to the next; 0 goes without graph and explorers."""
    cell: float = 1.1
    """Least edge of a cell, in root mean square changes of the achieved goal per step."""
    growth: float = 3.0
    """Cells grow up to this many times until they hold ``occupancy`` states each; else there is no graph."""
    occupancy: int = 20
    """States per occupied cell, in the mean."""
    n_goals: int = 1500
    """Cells to which paths are searched: all, or those of so many random places."""
    luck: float = 0.01
    """A crossing from cell to cell is luck, and no edge, if fewer than this share of the ways out are such."""
    n_lattices: int = 3
    """Lattices of cells, shifted against each other; steps are the mean of theirs."""
    control: float = 0.3
    """No graph where actions explain less than this share of how some part of the achieved goal changes in random play:
    cells cannot tell states apart whose ways on depend on what the achieved goal does not show. 0 forces a graph."""

    def __post_init__(self) -> None:
        check_ranges(self, every=(0, MANY), cell=(1e-3, 100), growth=(1, GROWTH[-1]), luck=(0, 1), control=(0, 1))
        check_ranges(self, occupancy=(1, MANY), n_goals=(1, MANY), n_lattices=(1, 100))


def explained(episodes: Episodes) -> float:
    """How far actions decide at once how the achieved goal changes: the least share explained of its parts, in [0, 1].

    Adjusted R^2 of a linear regression of phi(s_t+1) - phi(s_t) on a_t over random play; parts that never change do not
    count. It is about 0 for a valve that fingers push or a box out of reach.
    """
    change = episodes.steps(np.diff(episodes.achieved_goals.astype(np.float64), axis=1))
    actions = episodes.steps(episodes.actions).astype(np.float64)
    inputs = np.concatenate([actions, np.ones((len(actions), 1))], axis=1)
    rest = change - inputs @ np.linalg.lstsq(inputs, change, rcond=None)[0]
    moving, left = change.std(0) > 1e-9, len(actions) - inputs.shape[1]
    if not moving.any() or left < 1:
        return 0.0
    unexplained = rest.var(0)[moving] / change.var(0)[moving] * (len(actions) - 1) / left
    return float(np.clip(1.0 - unexplained, 0.0, 1.0).min())


class ReplayGraph:
    """Steps between achieved goals, from the transitions of D.

    They are the mean over lattices of cells that are shifted against each other, so that it changes more evenly than
    from cell to cell.

    Args:
        config: cells and edges.
        sparse_reward: the task's own, which says what is at a goal.

    Attributes:
        built_at: episodes that it was built from.
    """

    def __init__(self, config: GraphConfig, sparse_reward: SparseReward) -> None:
        self._config, self._sparse_reward, self.built_at = config, sparse_reward, 0
        self._lattices: list[Lattice] = []

    @property
    def n_cells(self) -> int:
        """Occupied cells of the first lattice; 0 while the data is too sparse for a graph."""
        return self._lattices[0].n_cells if self._lattices else 0

    @property
    def connected(self) -> float:
        """Share of pairs of cells with an observed path."""
        return float(np.mean([lattice.connected for lattice in self._lattices])) if self._lattices else 0.0

    def build(self, episodes: Episodes, seed: int) -> None:
        """Search all paths anew; the same episodes and seed give the same graph."""
        config, self.built_at = self._config, len(episodes)
        places = episodes.states(episodes.achieved_goals)
        drawn = places[np.random.default_rng([seed, len(episodes)]).integers(len(places), size=config.n_goals)]
        shifts = np.arange(config.n_lattices) / config.n_lattices
        made = [Lattice.of(episodes, config, shift) for shift in shifts]
        self._lattices = [lattice for lattice in made if lattice is not None]
        for lattice in self._lattices:
            lattice.search(episodes, config, self._sparse_reward, drawn)

    def steps(self, achieved: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """Steps ``(n,)`` of the shortest observed path from achieved goals to being at goals ``(n, G)``.

        NaN where no lattice knows: cells that nobody visited, pairs without a path, goals that were not searched.
        """
        total, known = np.zeros(len(goals), np.float32), np.zeros(len(goals), np.int64)
        for lattice in self._lattices:
            found = lattice.steps(achieved, goals)
            known += ~np.isnan(found)
            total += np.nan_to_num(found)
        return np.where(known > 0, total / np.maximum(known, 1), np.nan).astype(np.float32)

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
        connected: share of pairs of a cell and a searched goal with an observed path.
    """

    def __init__(self, episodes: Episodes, edge: np.ndarray, shift: float) -> None:
        self._visited = episodes.states(episodes.achieved_goals)
        low, high = self._visited.min(0).astype(np.float64), self._visited.max(0)
        self._edge, self._low = edge, low - shift * edge
        self._shape = np.floor((high - low) / edge).astype(np.int64) + 2
        numbers = _numbered(np.floor((self._visited - self._low) / edge), self._shape)
        self._numbers, self._cell_of = np.unique(numbers, return_inverse=True)
        self.n_cells, self.connected = len(self._numbers), 0.0

    @classmethod
    def of(cls, episodes: Episodes, config: GraphConfig, shift: float) -> Lattice | None:
        """The finest one with states enough in its cells; None where all would be too empty."""
        achieved = episodes.achieved_goals
        change = episodes.steps(np.diff(achieved.astype(np.float64), axis=1))
        span = np.ptp(episodes.states(achieved), axis=0)
        least, never = config.cell * np.sqrt((change**2).mean(0)), 1e-9 + 1e-6 * span  # what never moves: one cell
        for growth in [*(g for g in GROWTH if g < config.growth), config.growth]:
            edge = np.maximum(least * growth, never)
            if np.prod(span / edge + 2.0) < LARGEST:
                lattice = cls(episodes, edge, shift)
                if len(lattice._visited) >= config.occupancy * lattice.n_cells:
                    return lattice
        return None

    def search(self, episodes: Episodes, config: GraphConfig, sparse_reward: SparseReward, drawn: np.ndarray) -> None:
        """Dijkstra along observed crossings turned round, from all cells or those of ``drawn`` places ``(m, G)``."""
        from scipy.sparse import csr_matrix  # only training needs them, and every command imports this file
        from scipy.sparse.csgraph import dijkstra

        n, cells = self.n_cells, np.zeros(episodes.achieved_goals.shape[:2], np.int64)
        cells[episodes.seen()] = self._cell_of.ravel()
        start, end = episodes.steps(cells[:, :-1]), episodes.steps(cells[:, 1:])
        crossing = start != end
        edges, seen = np.unique(start[crossing] * n + end[crossing], return_counts=True)
        start, end = edges // n, edges % n
        usual = seen >= config.luck * np.bincount(start, seen, minlength=n)[start]
        start, end = start[usual], end[usual]
        centres = self._low + (_places(self._numbers, self._shape) + 0.5) * self._edge
        leaps = np.abs(centres[end] - centres[start]) / fastest(episodes)
        goals = np.arange(n) if n <= config.n_goals else np.unique(self.cell(drawn))
        # A goal is a node of its own, a step from every cell that counts as being there.
        at, goal = _accepted(centres, goals, sparse_reward)
        steps = np.concatenate([np.maximum(1.0, leaps.max(1, initial=0.0)), np.ones(len(at))])
        rows, columns = np.concatenate([end, n + goal]), np.concatenate([start, at])
        backwards = csr_matrix((steps, (rows, columns)), shape=(n + len(goals),) * 2)
        found = dijkstra(backwards, indices=n + np.arange(len(goals)))[:, :n]
        self._steps = found.astype(np.float32) - 1.0
        self._row = np.full(n, -1)
        self._row[goals] = np.arange(len(goals))
        self.connected = float(np.isfinite(self._steps).mean())

    def steps(self, achieved: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """As :meth:`ReplayGraph.steps`, for this lattice alone."""
        found = np.full(len(goals), np.nan, np.float32)
        here, there = self.cell(achieved), self.cell(goals)
        known = (here >= 0) & (there >= 0)
        known[known] = self._row[there[known]] >= 0
        steps = self._steps[self._row[there[known]], here[known]]
        steps[np.isinf(steps)] = np.nan
        found[known] = steps
        return found

    def cell(self, goals: np.ndarray) -> np.ndarray:
        """Index of the cell of goals ``(n, G)``; -1 where nobody was."""
        place = np.floor((goals - self._low) / self._edge)
        inside = np.all((place >= 0) & (place < self._shape), axis=-1)
        number = _numbered(np.where(inside[:, None], place, 0), self._shape)
        found = np.searchsorted(self._numbers, number)
        found[found == self.n_cells] = 0
        return np.where(inside & (self._numbers[found] == number), found, -1)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """As :meth:`ReplayGraph.draw`."""
        members = np.flatnonzero(self._cell_of == rng.integers(self.n_cells))
        return self._visited[rng.choice(members)]


def fastest(episodes: Episodes) -> np.ndarray:
    """Change per step of each part of the achieved goal ``(G,)`` at its fastest; +inf where it never changes."""
    change = episodes.steps(np.abs(np.diff(episodes.achieved_goals, axis=1)))
    return np.array([np.quantile(part[part > 0], FASTEST) if (part > 0).any() else np.inf for part in change.T])


def _accepted(centres: np.ndarray, goals: np.ndarray, sparse_reward: SparseReward) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of a cell and the index of a goal cell in ``goals`` where being in the one is being at the other."""
    at, goal = [goals], [np.arange(len(goals))]  # a cell is at itself, however wide
    places = centres.astype(np.float32)
    for k, cell in enumerate(goals):
        near = np.flatnonzero(sparse_reward(places, np.broadcast_to(places[cell], places.shape)) == 0)
        at.append(near[near != cell])
        goal.append(np.full(len(at[-1]), k))
    return np.concatenate(at), np.concatenate(goal)


def _numbered(places: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """One number for each cell ``(n, G)`` of a grid."""
    return np.asarray(np.ravel_multi_index(tuple(places.astype(np.int64).T), tuple(int(n) for n in shape)))


def _places(numbers: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Cells ``(n, G)`` by their numbers."""
    return np.stack(np.unravel_index(numbers, tuple(int(n) for n in shape)), axis=-1)
