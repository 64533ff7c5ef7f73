"""A grid world whose shortest paths are known, a distance in a table and exact counts: parts for the learner."""

import numpy as np
import torch
from scipy.sparse.csgraph import floyd_warshall

from napsp.data.episodes import Episodes

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

    def __init__(self, layout=WALLS, length=50):
        rows = [line.split() for line in layout.strip().splitlines()]
        cells = [(r, c) for r, row in enumerate(rows) for c, cell in enumerate(row) if cell == "."]
        index = {cell: i for i, cell in enumerate(cells)}
        self.n_states, self.n_actions, self.length = len(cells), len(MOVES), length
        self.successor = np.array([[index.get((r + dr, c + dc), index[r, c]) for dr, dc in MOVES] for r, c in cells])

    def shortest_paths(self):
        """Steps from s through first action a to g, ``(S, A, S)``: 1 + D[s', g], by Floyd-Warshall."""
        edges = np.zeros((self.n_states, self.n_states))
        edges[np.arange(self.n_states)[:, None], self.successor] = 1.0
        return 1.0 + floyd_warshall(edges, unweighted=True)[self.successor]

    def random_episodes(self, n, rng):
        """Random walks; states, actions and goals are indices in the last axis."""
        actions = rng.integers(self.n_actions, size=(n, self.length))
        states = np.empty((n, self.length + 1), np.int64)
        states[:, 0] = rng.integers(self.n_states, size=n)
        for t in range(self.length):
            states[:, t + 1] = self.successor[states[:, t], actions[:, t]]
        goals = rng.integers(self.n_states, size=(n, 1))
        columns = states[..., None].astype(np.float32)
        return Episodes(columns, columns, actions[..., None].astype(np.float32), goals.astype(np.float32))


class TabularDistance:
    """d_theta and d_theta_old as tables; a step of fit moves entries by ``rate`` of their mean error."""

    def __init__(self, world, start, rate=0.1):
        self.values = torch.full((world.n_states, world.n_actions, world.n_states), start)
        self.target_values = self.values.clone()
        self.rate = rate

    def rows(self, observations, actions, goals):
        return torch.from_numpy(np.concatenate([observations, actions, goals], axis=1)).long()

    def steps(self, rows):
        return self.values[tuple(rows.T)]

    def target_steps(self, rows):
        return self.target_values[tuple(rows.T)]

    def fit(self, rows, labels, n_sampled, weight=1.0):
        places, before = tuple(rows.T), self.steps(rows)
        total, count = torch.zeros_like(self.values), torch.zeros_like(self.values)
        total.index_put_(places, labels - before, accumulate=True)
        count.index_put_(places, torch.ones_like(labels), accumulate=True)
        self.values = self.values + weight * self.rate * total / count.clamp(min=1.0)
        return (labels - before).square().sum() / n_sampled, before

    def update_target(self):
        self.target_values = self.values.clone()

    def rescale(self, scaling):
        pass


class ExactCounts:
    """N(s, a) and N(s, a, g) without hashing."""

    def __init__(self, world):
        self._visits = np.zeros((world.n_states, world.n_actions), np.int64)
        self._reached = np.zeros((world.n_states, world.n_actions, world.n_states), np.int64)

    def update(self, episodes):
        states, actions = episodes.observations[..., 0].astype(int), episodes.actions[..., 0].astype(int)
        np.add.at(self._visits, (states[:, :-1], actions), 1)
        first, later = np.triu_indices(states.shape[1], k=1)
        np.add.at(self._reached, (states[:, first], actions[:, first], states[:, later]), 1)

    def recount(self, episodes, scaling):
        pass

    def visits(self, observations, actions):
        return self._visits[observations[:, 0].astype(int), actions[:, 0].astype(int)]

    def reached(self, observations, actions, goals):
        return self._reached[observations[:, 0].astype(int), actions[:, 0].astype(int), goals[:, 0].astype(int)]
