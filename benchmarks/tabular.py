"""The paper's losses where the truth is known: a grid world with exact counts against Floyd-Warshall.

``python -m benchmarks.tabular`` learns d(s, a, g) in a table with eq. 4a and 4b - the very label
functions of ``napsp.distance.labels`` - and compares it with scipy's all-pairs shortest paths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.sparse.csgraph import floyd_warshall
from scipy.stats import spearmanr
from torch import Tensor

from benchmarks.command import read_options
from napsp.data.buffer import EpisodeBuffer, sample_pairs, sample_triples
from napsp.data.episodes import Episodes
from napsp.distance.counts import uncertainty
from napsp.distance.labels import hypotenuse, temporal_label
from napsp.errors import run_command

WALLS = """
. . # . .
. . # . .
. . . . .
. . # . .
. . # . .
"""
MOVES = ((0, 1), (0, -1), (1, 0), (-1, 0))


class GridWorld:
    """Deterministic moves on a small grid with a wall and one gap; a blocked move stays put."""

    def __init__(self, layout: str = WALLS, horizon: int = 30) -> None:
        rows = [line.split() for line in layout.strip().splitlines()]
        cells = [(r, c) for r, row in enumerate(rows) for c, cell in enumerate(row) if cell == "."]
        index = {cell: i for i, cell in enumerate(cells)}
        self.n_states, self.n_actions, self.horizon = len(cells), len(MOVES), horizon
        self.successor = np.array([[index.get((r + dr, c + dc), index[r, c]) for dr, dc in MOVES] for r, c in cells])

    def shortest_paths(self) -> np.ndarray:
        """Steps from s through first action a to g, ``(S, A, S)``: 1 + D[s', g]."""
        edges = np.zeros((self.n_states, self.n_states))
        edges[np.arange(self.n_states)[:, None], self.successor] = 1.0
        return 1.0 + floyd_warshall(edges, unweighted=True)[self.successor]

    def random_episodes(self, n: int, rng: np.random.Generator) -> Episodes:
        """Random walks; states, actions and goals are indices in the last axis."""
        actions = rng.integers(self.n_actions, size=(n, self.horizon))
        states = np.empty((n, self.horizon + 1), np.int64)
        states[:, 0] = rng.integers(self.n_states, size=n)
        for t in range(self.horizon):
            states[:, t + 1] = self.successor[states[:, t], actions[:, t]]
        goals = rng.integers(self.n_states, size=(n, 1))
        columns = states[..., None].astype(np.float32)
        return Episodes(columns, columns, actions[..., None].astype(np.float32), goals.astype(np.float32))


class TabularDistance:
    """d(s, a, g) as a table that is fitted by averaging towards labels."""

    def __init__(self, n_states: int, n_actions: int, start: float = 0.0) -> None:
        self.values = torch.full((n_states, n_actions, n_states), start)

    def look_up(self, states: object, actions: object, goals: object) -> Tensor:
        """D at index rows, ``(B,)``."""
        return self.values[_indices(states), _indices(actions), _indices(goals)]

    def fit(self, states: object, actions: object, goals: object, labels: Tensor, rate: float) -> None:
        """One gradient step on the squared error; entries that occur twice move by their mean."""
        places = _indices(states), _indices(actions), _indices(goals)
        total, count = torch.zeros_like(self.values), torch.zeros_like(self.values)
        total.index_put_(places, labels - self.values[places], accumulate=True)
        count.index_put_(places, torch.ones_like(labels), accumulate=True)
        self.values += rate * total / count.clamp(min=1.0)


class ExactCounts:
    """N(s, a) and N(s, a, g) without hashing."""

    def __init__(self, world: GridWorld) -> None:
        self._visits = np.zeros((world.n_states, world.n_actions), np.int64)
        self._reached = np.zeros((world.n_states, world.n_actions, world.n_states), np.int64)

    def update(self, episodes: Episodes) -> None:
        """Count visits and later goals."""
        states, actions = episodes.observations[..., 0].astype(int), episodes.actions[..., 0].astype(int)
        np.add.at(self._visits, (states[:, :-1], actions), 1)
        first, later = np.triu_indices(states.shape[1], k=1)
        np.add.at(self._reached, (states[:, first], actions[:, first], states[:, later]), 1)

    def visits(self, states: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """N(s, a)."""
        return self._visits[_indices(states), _indices(actions)]

    def reached(self, states: np.ndarray, actions: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """N(s, a, g)."""
        return self._reached[_indices(states), _indices(actions), _indices(goals)]


def learn(
    world: GridWorld,
    rng: np.random.Generator,
    n_iterations: int = 250,
    uncertainty_scale: float = 30.0,
    uncertainty_power: float = 2.0,
) -> TabularDistance:
    """Algorithm 1 without a policy: random walks, eq. 4a, target copy, eq. 4b."""
    distance = TabularDistance(world.n_states, world.n_actions, start=float(world.horizon))
    counts, buffer = ExactCounts(world), EpisodeBuffer()
    buffer.extend(world.random_episodes(10, rng))
    target = TabularDistance(world.n_states, world.n_actions)
    for _ in range(n_iterations):
        recent = world.random_episodes(10, rng)
        counts.update(recent)
        target.values = distance.values.clone()
        for _ in range(20):
            pairs = sample_pairs(buffer.episodes(), 2048, rng)
            rows = pairs.observations, pairs.actions, pairs.goals
            bonus = uncertainty(counts.visits(*rows[:2]), uncertainty_scale, uncertainty_power)
            steps_between = torch.from_numpy(pairs.steps_between)
            labels = temporal_label(steps_between, target.look_up(*rows), torch.from_numpy(bonus.astype(np.float32)))
            distance.fit(*rows, labels, rate=0.1)
        target.values = distance.values.clone()
        triples = sample_triples(recent, buffer.episodes(), 2048, rng)
        rows = triples.observations, triples.actions, triples.goals
        waypoint = triples.waypoints, triples.waypoint_actions
        passed = (counts.reached(*rows) == 0) & (counts.reached(*waypoint, triples.goals) > 0)
        if passed.any():
            start = [array[passed] for array in rows]
            first_leg = target.look_up(start[0], start[1], triples.waypoint_goals[passed])
            second_leg = target.look_up(waypoint[0][passed], waypoint[1][passed], start[2])
            distance.fit(*start, hypotenuse(first_leg, second_leg, float(world.horizon)), rate=0.1)
        buffer.extend(recent)
    return distance


def spearman_against_truth(world: GridWorld, distance: TabularDistance) -> tuple[float, float]:
    """Rank correlation with Floyd-Warshall over all (s, a, g), and mean learned / true."""
    truth, learned = world.shortest_paths().ravel(), distance.values.numpy().ravel()
    return float(spearmanr(truth, learned).statistic), float((learned / truth).mean())


def _indices(rows: object) -> Tensor:
    return torch.as_tensor(np.asarray(rows), dtype=torch.int64).reshape(-1)


@dataclass(frozen=True)
class TabularOptions:
    """Learn distances in a table and compare them with Floyd-Warshall."""

    seed: int = 0
    """Seed of the random walks."""
    iterations: tuple[int, ...] = (5, 25, 100, 250, 500)
    """Iterations of ten random walks each."""


def main() -> int:
    """Print the comparison."""
    options = read_options(TabularOptions, "tabular")
    world = GridWorld()
    for n_iterations in options.iterations:
        distance = learn(world, np.random.default_rng(options.seed), n_iterations)
        spearman, ratio = spearman_against_truth(world, distance)
        print(f"{10 * n_iterations:5d} random walks   Spearman {spearman:.3f}   learned / true {ratio:.2f}")
    return 0


if __name__ == "__main__":
    run_command(main)
