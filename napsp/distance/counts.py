"""Count models N(s, a) and N(s, a, g) by locality-sensitive hashing (paper, section 4.2).

SimHash (Tang et al. 2017): the signs of k random projections of the centred and scaled
input are a k-bit key. Keys are stored exactly, never in a shared table, so "never seen" -
the N = 0 that switches the triangular loss - has no false negatives from collisions of slots.
"""

from __future__ import annotations

import numpy as np

from napsp.data.episodes import Episodes
from napsp.scaling import Scaling

RECOUNT_CHUNK = 200  # episodes; the keys of their pairs i < j fill 2 MB at T = 50, 400 MB at T = 700


class HashedCounts:
    """Counts of SimHash keys, kept sorted for exact look-up.

    Args:
        projection: ``(input_size + 1, n_bits)``; see :meth:`drawn`.
        keys: ascending, ``(K,)``.
        counts: of the keys, ``(K,)``.
    """

    def __init__(
        self, projection: np.ndarray, keys: np.ndarray | None = None, counts: np.ndarray | None = None
    ) -> None:
        self.projection = projection
        self.keys = np.empty(0, np.int64) if keys is None else keys
        self.counts = np.empty(0, np.int64) if counts is None else counts

    @classmethod
    def drawn(cls, input_size: int, n_bits: int, rng: np.random.Generator) -> HashedCounts:
        """No counts yet, and a random projection."""
        # One extra constant input makes the cuts affine: without it all inputs on a ray
        # from the centre share a key.
        return cls(rng.standard_normal((input_size + 1, n_bits)))

    def key(self, inputs: np.ndarray) -> np.ndarray:
        """Keys ``(...)`` of scaled inputs ``(..., input_size)``."""
        return _packed(inputs @ self.projection[:-1] + self.projection[-1])

    def joint_keys(self, first: np.ndarray, second: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """Keys ``(P,)`` of the inputs ``[first[i], second[j]]`` for P index pairs, joined after projecting each once.

        A long episode has far more pairs than states.
        """
        split = first.shape[-1]
        left, right = first @ self.projection[:split], second @ self.projection[split:-1] + self.projection[-1]
        return _packed(left[i] + right[j])

    def add(self, inputs: np.ndarray) -> None:
        """Count every row of ``(B, input_size)`` once."""
        self.add_keys(self.key(inputs))

    def add_keys(self, keys: np.ndarray) -> None:
        """Count every key of ``(B,)`` once."""
        keys, counts = np.unique(keys, return_counts=True)
        places = np.searchsorted(self.keys, keys)
        known = np.zeros(len(keys), bool)
        inside = places < len(self.keys)
        known[inside] = self.keys[places[inside]] == keys[inside]
        self.counts[places[known]] += counts[known]
        self.keys = np.insert(self.keys, places[~known], keys[~known])
        self.counts = np.insert(self.counts, places[~known], counts[~known])

    def count(self, inputs: np.ndarray) -> np.ndarray:
        """How often inputs with the same key were added, ``(B,)``; 0 if never."""
        if not len(self.keys):
            return np.zeros(len(inputs), np.int64)
        keys = self.key(inputs)
        places = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(self.keys[places] == keys, self.counts[places], 0)


class CountModel:
    """N(s, a) and N(s, a, g), fed with whole episodes; and U of eq. 2.

    ``scaling`` maps raw (observation, goal) to centred, scaled ones and must stay fixed
    while counts exist: a key that moves loses its history. :meth:`recount` changes it.
    """

    def __init__(
        self,
        sizes: tuple[int, int, int],
        visit_bits: int,
        reached_bits: int,
        scaling: Scaling,
        rng: np.random.Generator,
    ) -> None:
        n_observation, n_action, n_goal = sizes
        self.scaling = scaling
        self.visit_table = HashedCounts.drawn(n_observation + n_action, visit_bits, rng)
        self.reached_table = HashedCounts.drawn(n_observation + n_action + n_goal, reached_bits, rng)

    def update(self, episodes: Episodes) -> None:
        """Count every visited (s_i, a_i) and every (s_i, a_i, phi(s_j)) with j > i.

        Algorithm 1, line 4. Each pair i < j of an episode counts once.
        """
        n_episodes, horizon = episodes.actions.shape[:2]
        pairs = self._pairs(episodes.observations[:, :-1], episodes.actions)
        self.visit_table.add(pairs.reshape(n_episodes * horizon, -1))
        goals = self.scaling.goal(episodes.achieved_goals)
        first, later = np.triu_indices(horizon + 1, k=1)
        keys = [self.reached_table.joint_keys(*episode, first, later) for episode in zip(pairs, goals, strict=True)]
        self.reached_table.add_keys(np.concatenate(keys))

    def recount(self, episodes: Episodes, scaling: Scaling) -> None:
        """Count all episodes again under another scaling."""
        self.scaling = scaling
        for table in (self.visit_table, self.reached_table):
            table.keys, table.counts = np.empty(0, np.int64), np.empty(0, np.int64)
        for start in range(0, len(episodes), RECOUNT_CHUNK):
            self.update(episodes[start : start + RECOUNT_CHUNK])

    def visits(self, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """N(s, a), ``(B,)``."""
        return Visits(self.visit_table, self.scaling)(observations, actions)

    def reached(self, observations: np.ndarray, actions: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """N(s, a, g), ``(B,)``: how often g was reached later in an episode through (s, a)."""
        pairs = self._pairs(observations, actions)
        return self.reached_table.count(np.concatenate([pairs, self.scaling.goal(goals)], axis=-1))

    def _pairs(self, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        return _pairs(self.scaling, observations, actions)


class Visits:
    """N(s, a) alone: what of the counts a model file keeps for planning."""

    def __init__(self, table: HashedCounts, scaling: Scaling) -> None:
        self.table, self.scaling = table, scaling

    def __call__(self, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """N(s, a), ``(B,)``."""
        return self.table.count(_pairs(self.scaling, observations, actions))


def _packed(projected: np.ndarray) -> np.ndarray:
    """Signs of ``(..., n_bits)`` numbers as the bits of integers ``(...)``."""
    packed = np.packbits(projected > 0, axis=-1, bitorder="little")
    filled = np.zeros((*packed.shape[:-1], 8), np.uint8)
    filled[..., : packed.shape[-1]] = packed
    return filled.view("<i8")[..., 0].astype(np.int64)


def _pairs(scaling: Scaling, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
    return np.concatenate([scaling.observation(observations), actions], axis=-1)


def uncertainty(visits: np.ndarray, scale: float, power: float) -> np.ndarray:
    """U = C / (1 + N(s, a))^M in steps (eq. 2); ``visits`` any shape."""
    return scale / (1.0 + visits) ** power
