"""Count models N(s, a) and N(s, a, g) by locality-sensitive hashing (paper, section 4.2).

N(s, a): SimHash (Tang et al. 2017) - the signs of k random projections of the centred and scaled input are its key.

N(s, a, g) decides where eq. 4b applies, so its key has two parts, each with its own resolution: a SimHash of (s, a),
and the cell of g in a randomly shifted lattice (Datar et al. 2004). One SimHash of all three together calls goals
reached that nobody came near: the goal is a few of many inputs, and its cells are as wide as the space. Near the border
of a cell a lattice errs the other way, so there are several, and the largest of their counts is N.

Keys are stored exactly, never in a shared table, so "never seen" has no false negatives from collisions of slots.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from napsp.data.episodes import Episodes
from napsp.scaling import Scaling
from napsp.settings import MANY, TINY, check_ranges

RECOUNT_CHUNK = 200  # episodes
PAIRS_AT_ONCE = 2**18  # keys of pairs i < j, 2 MB; sorting them takes a few times that, however long an episode is


@dataclass(frozen=True)
class CountConfig:
    """Resolution of the counts; inputs are in standard deviations."""

    visit_bits: int = 16
    """SimHash bits of N(s, a)."""
    pair_bits: int = 8
    """SimHash bits of (s, a) in the key of N(s, a, g)."""
    goal_cell: float = 0.14
    """Edge of the goal's cells in N(s, a, g), in standard deviations, per number of a goal: the more there are, the
    farther apart the same amount of data lies."""
    n_lattices: int = 3
    """Shifted lattices of goals; N(s, a, g) is the largest of their counts."""

    def __post_init__(self) -> None:
        check_ranges(self, visit_bits=(1, 62), pair_bits=(1, 62), goal_cell=(TINY, MANY), n_lattices=(1, 100))


@dataclass(frozen=True)
class UncertaintyConfig:
    """U = C / (1 + N(s, a))^M, eq. 2."""

    scale: float = 10.0
    """C, in steps."""
    power: float = 0.5
    """M."""

    def __post_init__(self) -> None:
        check_ranges(self, scale=(TINY, MANY), power=(TINY, 100))

    def __call__(self, visits: np.ndarray) -> np.ndarray:
        """U in steps for N(s, a) of any shape."""
        return uncertainty(visits, self.scale, self.power)


def uncertainty(visits: np.ndarray, scale: float, power: float) -> np.ndarray:
    """U = C / (1 + N(s, a))^M in steps (eq. 2); ``visits`` any shape."""
    return scale / (1.0 + visits) ** power


class KeyCounts:
    """Counts of integer keys, kept sorted for exact look-up.

    Args:
        keys: ascending, ``(K,)``.
        counts: of the keys, ``(K,)``.

    Attributes:
        news: what was added since :meth:`watch`; None before, and once all was forgotten.
    """

    def __init__(self, keys: np.ndarray | None = None, counts: np.ndarray | None = None) -> None:
        self.keys = np.empty(0, np.int64) if keys is None else keys
        self.counts = np.empty(0, np.int64) if counts is None else counts
        self.news: KeyCounts | None = None

    def __len__(self) -> int:
        return len(self.keys)

    def watch(self) -> None:
        """Gather what is added from now on."""
        self.news = KeyCounts()

    def add(self, keys: np.ndarray) -> None:
        """Count every key of ``(B,)`` once."""
        self.merge(*np.unique(keys, return_counts=True))

    def merge(self, keys: np.ndarray, counts: np.ndarray) -> None:
        """Count ascending keys ``(B,)`` so many times each."""
        if self.news is not None:
            self.news.merge(keys, counts)
        places = np.searchsorted(self.keys, keys)
        known = np.zeros(len(keys), bool)
        inside = places < len(self.keys)
        known[inside] = self.keys[places[inside]] == keys[inside]
        self.counts[places[known]] += counts[known]
        self.keys = np.insert(self.keys, places[~known], keys[~known])
        self.counts = np.insert(self.counts, places[~known], counts[~known])

    def count(self, keys: np.ndarray) -> np.ndarray:
        """How often keys ``(B,)`` were added; 0 if never."""
        if not len(self.keys):
            return np.zeros(len(keys), np.int64)
        places = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(self.keys[places] == keys, self.counts[places], 0)

    def clear(self) -> None:
        """Forget everything."""
        self.keys, self.counts, self.news = np.empty(0, np.int64), np.empty(0, np.int64), None


class SimHash:
    """Signs of random affine projections as an integer key.

    Args:
        projection: ``(input_size + 1, n_bits)``. The last row is a constant input's, which makes the cuts affine:
            without it all inputs on a ray from the centre share a key.
    """

    def __init__(self, projection: np.ndarray) -> None:
        self.projection = projection

    @classmethod
    def drawn(cls, used: np.ndarray, n_bits: int, rng: np.random.Generator) -> SimHash:
        """A random projection of the inputs that are ``used``, bool ``(input_size,)``; the others do not enter."""
        projection = rng.standard_normal((len(used) + 1, n_bits))
        projection[:-1][~used] = 0.0
        return cls(projection)

    def __call__(self, inputs: np.ndarray) -> np.ndarray:
        """Keys ``(...)`` of inputs ``(..., input_size)``."""
        signs = inputs @ self.projection[:-1] + self.projection[-1] > 0
        packed = np.packbits(signs, axis=-1, bitorder="little")
        filled = np.zeros((*packed.shape[:-1], 8), np.uint8)
        filled[..., : packed.shape[-1]] = packed
        return filled.view("<i8")[..., 0].astype(np.int64)


class ReachedTable:
    """Counts of (s, a, g) for one SimHash of (s, a) and one lattice of goals.

    A key is a sum, modulo 2^64, of random odd multiples of the pair's key and of the cell's numbers: two different ones
    coincide with a chance below 2^-50, and the keys of all pairs of a long episode cost one addition each.

    Args:
        pair: key of (s, a).
        shift: of the lattice, in cells, ``(G,)``.
        multipliers: odd int64 ``(G + 1,)``, the pair's first.
        edge: of a cell, in standard deviations.
    """

    def __init__(self, pair: SimHash, shift: np.ndarray, multipliers: np.ndarray, edge: float) -> None:
        self.pair, self.shift, self.multipliers, self.edge = pair, shift, multipliers, edge
        self.table = KeyCounts()

    @classmethod
    def drawn(cls, used: np.ndarray, shift: np.ndarray, config: CountConfig, rng: np.random.Generator) -> ReachedTable:
        """A random one with this shift of its lattice; ``used`` as in :meth:`SimHash.drawn`."""
        multipliers = rng.integers(-(2**62), 2**62, len(shift) + 1) * 2 + 1
        pair = SimHash.drawn(used, config.pair_bits, rng)
        return cls(pair, shift, multipliers, config.goal_cell * len(shift))

    def pair_part(self, pairs: np.ndarray) -> np.ndarray:
        """What (s, a) adds to a key, ``(...)`` for scaled inputs ``(..., O + A)``."""
        return self.pair(pairs) * self.multipliers[0]

    def goal_part(self, goals: np.ndarray) -> np.ndarray:
        """What g adds to a key, ``(...)`` for scaled goals ``(..., G)``."""
        cells = np.floor(goals / self.edge + self.shift).astype(np.int64)
        return (cells * self.multipliers[1:]).sum(-1)


class CountModel:
    """N(s, a) and N(s, a, g), fed with whole episodes.

    ``scaling`` maps raw (observation, goal) to centred, scaled ones and must stay fixed while counts exist: a key that
    moves loses its history. :meth:`recount` changes it.

    Args:
        sizes: of observation, action and goal.
        config: resolutions.
        scaling: see above.
        rng: draws the hashes.
        used_actions: which numbers of an action change anything, bool ``(A,)``; None is all. The others would tell
            apart what is the same.
        counts_goals: count N(s, a, g) as well as N(s, a). Its hashes come from a stream of their own, so that all
            else that is drawn does not depend on it.
    """

    def __init__(
        self,
        sizes: tuple[int, int, int],
        config: CountConfig,
        scaling: Scaling,
        rng: np.random.Generator,
        used_actions: np.ndarray | None = None,
        counts_goals: bool = True,
    ) -> None:
        n_observation, n_action, n_goal = sizes
        acting = np.ones(n_action, bool) if used_actions is None else used_actions
        used = np.concatenate([np.ones(n_observation, bool), acting])
        self.scaling = scaling
        self.visit_hash, self.visit_table = SimHash.drawn(used, config.visit_bits, rng), KeyCounts()
        # Evenly spread, so that what lies at a border of one lattice lies inside a cell of another.
        own = rng.spawn(1)[0]
        shift, n = own.uniform(size=n_goal), config.n_lattices
        shifts = [(shift + k / n) % 1.0 for k in range(n)] if counts_goals else []
        self.reached_tables = [ReachedTable.drawn(used, moved, config, own) for moved in shifts]

    def update(self, episodes: Episodes) -> None:
        """Count every visited (s_i, a_i) and every (s_i, a_i, phi(s_j)) with j > i.

        Algorithm 1, line 4. Each pair i < j of an episode counts once. Working memory does not grow with T squared, and
        the tables grow with the cells that were seen.
        """
        pairs = scaled_pairs(self.scaling, episodes.observations[:, :-1], episodes.actions)
        self.visit_table.add(self.visit_hash(episodes.steps(pairs)))
        goals = self.scaling.goal(episodes.achieved_goals)
        for table in self.reached_tables:
            starts, ends = table.pair_part(pairs), table.goal_part(goals)
            for first, later in _pairs(goals.shape[1], max(1, PAIRS_AT_ONCE // max(1, len(episodes)))):
                keys = starts[:, first] + ends[:, later]
                happened = later <= episodes.lengths[:, None]
                table.table.add(keys[happened])

    def recount(self, episodes: Episodes, scaling: Scaling) -> None:
        """Count all episodes again under another scaling."""
        self.scaling = scaling
        for table in self.tables():
            table.clear()
        for start in range(0, len(episodes), RECOUNT_CHUNK):
            self.update(episodes[start : start + RECOUNT_CHUNK])

    def visits(self, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """N(s, a), ``(B,)``."""
        return self.visit_counts(observations, actions)

    @property
    def visit_counts(self) -> VisitCounts:
        """N(s, a) alone, as a model file keeps it."""
        return VisitCounts(self.visit_hash, self.visit_table, self.scaling)

    def reached(self, observations: np.ndarray, actions: np.ndarray, goals: np.ndarray) -> np.ndarray:
        """N(s, a, g), ``(B,)``: how often g was reached later in an episode through (s, a)."""
        pairs, goals = scaled_pairs(self.scaling, observations, actions), self.scaling.goal(goals)
        counts = [table.table.count(table.pair_part(pairs) + table.goal_part(goals)) for table in self.reached_tables]
        return np.max(counts, axis=0)

    def tables(self) -> Sequence[KeyCounts]:
        """All counts: N(s, a), then those of N(s, a, g)."""
        return [self.visit_table, *(table.table for table in self.reached_tables)]


class VisitCounts:
    """N(s, a) alone: what of the counts a model file keeps for planning."""

    def __init__(self, simhash: SimHash, table: KeyCounts, scaling: Scaling) -> None:
        self.hash, self.table, self.scaling = simhash, table, scaling

    def __call__(self, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """N(s, a), ``(B,)``."""
        return self.table.count(self.hash(scaled_pairs(self.scaling, observations, actions)))


def _pairs(n_states: int, at_once: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """All i < j below ``n_states``, in parts of about ``at_once``, each of whole rows of one i."""
    rows = max(1, at_once // n_states)
    for start in range(0, n_states - 1, rows):
        first = np.arange(start, min(start + rows, n_states - 1))
        i, j = np.nonzero(np.arange(n_states) > first[:, None])
        yield i + start, j


def scaled_pairs(scaling: Scaling, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
    """What the hash of (s, a) reads, ``(..., O + A)``: the scaled observation and the action."""
    return np.concatenate([scaling.observation(observations), actions], axis=-1)
