"""A batch of episodes, how they ended, and what judges them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

CUT, ARRIVED, LOST, BLOWN = range(4)
"""How an episode ended.

CUT: by a time limit, whose or which does not matter: the world would have gone on.
ARRIVED: the environment terminated it at its desired goal.
LOST: the environment terminated it elsewhere: nothing is reached any more.
BLOWN: the next state was none, because the simulation had blown up; what came before goes on as after CUT.
"""


@dataclass(frozen=True)
class Episodes:
    """A batch of E episodes of up to T steps, float32.

    Episode e has ``lengths[e]`` steps. Its last state stands in all rows after its end as well, with actions of zero:
    what reads them says so, by ``lengths`` or one of the masks.

    Attributes:
        observations: s_0 .. s_T, ``(E, T + 1, O)``.
        achieved_goals: phi(s_0) .. phi(s_T), ``(E, T + 1, G)``.
        actions: a_0 .. a_{T-1}, ``(E, T, A)``.
        desired_goals: the goal the episode was collected for, ``(E, G)``.
        lengths: steps, int64 ``(E,)``; by default T.
        endings: ``CUT``, ``ARRIVED``, ``LOST`` or ``BLOWN``, uint8 ``(E,)``; by default ``CUT``.
    """

    observations: np.ndarray
    achieved_goals: np.ndarray
    actions: np.ndarray
    desired_goals: np.ndarray
    lengths: np.ndarray = field(default=None)  # type: ignore[assignment]
    endings: np.ndarray = field(default=None)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        n, length = self.actions.shape[:2]
        if self.lengths is None:
            object.__setattr__(self, "lengths", np.full(n, length))
        if self.endings is None:
            object.__setattr__(self, "endings", np.full(n, CUT, np.uint8))

    def __len__(self) -> int:
        return len(self.actions)

    def __getitem__(self, part: slice) -> Episodes:
        return Episodes(*(getattr(self, name)[part] for name in FIELDS))

    @property
    def whole(self) -> bool:
        """Whether all have T steps."""
        return bool((self.lengths == self.actions.shape[1]).all())

    @property
    def n_steps(self) -> int:
        """Steps of all episodes."""
        return int(self.lengths.sum())

    @property
    def arriving_ends(self) -> bool:
        """Whether any was terminated at its desired goal: others would have been at theirs."""
        return bool((self.endings == ARRIVED).any())

    def lost(self, episode: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Whether steps t of episodes, both ``(n,)``, are the last before a loss, bool ``(n,)``."""
        return (self.endings[episode] == LOST) & (t + 1 == self.lengths[episode])

    def happened(self) -> np.ndarray:
        """Which steps there were, bool ``(E, T)``."""
        return np.arange(self.actions.shape[1]) < self.lengths[:, None]

    def seen(self) -> np.ndarray:
        """Which states there were, bool ``(E, T + 1)``."""
        return np.arange(self.actions.shape[1] + 1) <= self.lengths[:, None]

    def states(self, values: np.ndarray) -> np.ndarray:
        """Rows ``(n, ...)`` of ``values`` ``(E, T + 1, ...)`` at the states that there were."""
        return values.reshape(-1, *values.shape[2:]) if self.whole else values[self.seen()]

    def steps(self, values: np.ndarray) -> np.ndarray:
        """Rows ``(n, ...)`` of ``values`` ``(E, T, ...)`` at the steps that there were."""
        return values.reshape(-1, *values.shape[2:]) if self.whole else values[self.happened()]


SparseReward = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Maps achieved goals ``(n, G)`` and goals ``(n, G)`` to rewards ``(n,)``: 0 where reached, else -1."""


FIELDS = ("observations", "achieved_goals", "actions", "desired_goals", "lengths", "endings")


def concatenate(parts: list[Episodes]) -> Episodes:
    """Join batches of episodes."""
    return Episodes(*(np.concatenate([getattr(part, name) for part in parts]) for name in FIELDS))


def draw_steps(episodes: Episodes, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw n steps, every one of all episodes as likely: the episode ``(n,)`` of each, and its place in it ``(n,)``."""
    if episodes.whole:
        return rng.integers(len(episodes), size=n), rng.integers(episodes.actions.shape[1], size=n)
    ends = np.cumsum(episodes.lengths)
    number = rng.integers(ends[-1], size=n)
    episode = np.searchsorted(ends, number, side="right")
    return episode, number - (ends - episodes.lengths)[episode]
