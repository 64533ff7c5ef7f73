"""Episodes, the replay buffer D, and everything that is sampled from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from napsp.data.episodes import BLOWN, FIELDS, Episodes, SparseReward, draw_steps


@dataclass(frozen=True)
class Pairs:
    """(s_i, a_i, phi(s_j)) of one episode with j > i; B rows (Algorithm 1, lines 6-7)."""

    observations: np.ndarray
    actions: np.ndarray
    goals: np.ndarray
    steps_between: np.ndarray


@dataclass(frozen=True)
class Triples:
    """(s_i, a_i) and s_g from D_last, waypoint (s_j, a_j) from D (Algorithm 1, lines 11-12)."""

    observations: np.ndarray
    actions: np.ndarray
    goals: np.ndarray
    waypoints: np.ndarray
    waypoint_actions: np.ndarray
    waypoint_goals: np.ndarray
    lost: np.ndarray
    """Whether a_i ended its episode where nothing is reached any more, bool."""


class EpisodeBuffer:
    """D: all episodes so far, or the last ones of them, in order, in arrays that grow by doubling.

    Attributes:
        n_seen: episodes that ever were in D.
        n_steps: steps of them.
        n_blown: those that ended because the simulation had blown up.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, np.ndarray] = {}
        self._start, self._end = 0, 0
        self.n_seen, self.n_steps, self.n_blown = 0, 0, 0

    def __len__(self) -> int:
        return self._end - self._start

    def extend(self, episodes: Episodes) -> None:
        """D <- D + D_last (Algorithm 1, line 22)."""
        if not self._arrays or self._end + len(episodes) > len(self._arrays["lengths"]):
            self.reserve(max(len(self) + len(episodes), 2 * len(self), 64), episodes)
        end = self._end + len(episodes)
        for name in FIELDS:
            self._arrays[name][self._end : end] = getattr(episodes, name)
        self._end = end
        self.n_seen += len(episodes)
        self.n_steps += episodes.n_steps
        self.n_blown += int((episodes.endings == BLOWN).sum())

    def reserve(self, n: int, like: Episodes) -> None:
        """Move what is stored into arrays for n episodes of the shapes of ``like``."""
        for name in FIELDS:  # one at a time: no more than one of them is there twice
            new = getattr(like, name)
            moved = np.empty((n, *new.shape[1:]), new.dtype)
            if name in self._arrays:
                moved[: len(self)] = self._arrays[name][self._start : self._end]
            self._arrays[name] = moved
        self._start, self._end = 0, len(self)

    def forget(self, capacity: int | None) -> None:
        """Let the oldest episodes go until ``capacity`` are left; None keeps all."""
        if capacity is not None:
            self._start = max(self._start, self._end - capacity)

    def episodes(self, last: int | None = None) -> Episodes:
        """All stored episodes, or the ``last`` most recent ones (views, not copies)."""
        start = self._start if last is None else max(self._start, self._end - last)
        return Episodes(**{name: self._arrays[name][start : self._end] for name in FIELDS})


def sample_pairs(
    episodes: Episodes, n: int, rng: np.random.Generator, sparse_reward: SparseReward | None = None
) -> Pairs:
    """Draw n pairs i < j, uniform over the pairs of an episode; an episode is as likely as it is long.

    With ``sparse_reward`` the steps between them end where it first finds the goal phi(s_j) reached.
    """
    if episodes.whole:
        episode, length = rng.integers(len(episodes), size=n), episodes.actions.shape[1]
    else:
        episode = draw_steps(episodes, n, rng)[0]
        length = episodes.lengths[episode]
    first = rng.integers(length + 1, size=n)
    second = rng.integers(length, size=n)
    second += second >= first  # a uniform ordered pair without equal indices
    i, j = np.minimum(first, second), np.maximum(first, second)
    goals = episodes.achieved_goals[episode, j]
    arrival = j if sparse_reward is None else _first_arrivals(episodes, episode, i, j, goals, sparse_reward)
    return Pairs(
        observations=episodes.observations[episode, i],
        actions=episodes.actions[episode, i],
        goals=goals,
        steps_between=(arrival - i).astype(np.float32),
    )


def _first_arrivals(
    episodes: Episodes,
    episode: np.ndarray,
    i: np.ndarray,
    j: np.ndarray,
    goals: np.ndarray,
    sparse_reward: SparseReward,
) -> np.ndarray:
    """The first step ``(n,)`` after i, and at most j, at which the goal is reached."""
    arrival, open_ = i.copy(), np.arange(len(i))
    while len(open_):
        arrival[open_] += 1
        achieved = episodes.achieved_goals[episode[open_], arrival[open_]]
        missed = sparse_reward(achieved, goals[open_]) < 0
        open_ = open_[missed & (arrival[open_] < j[open_])]
    return arrival


def sample_triples(recent: Episodes, everything: Episodes, n: int, rng: np.random.Generator) -> Triples:
    """Draw n triples: s_i and its episode's desired goal from D_last, s_j from D."""
    episode, i = draw_steps(recent, n, rng)
    other, j = draw_steps(everything, n, rng)
    return Triples(
        observations=recent.observations[episode, i],
        actions=recent.actions[episode, i],
        goals=recent.desired_goals[episode],
        waypoints=everything.observations[other, j],
        waypoint_actions=everything.actions[other, j],
        waypoint_goals=everything.achieved_goals[other, j],
        lost=recent.lost(episode, i),
    )
