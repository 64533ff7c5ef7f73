"""Hindsight experience replay: transitions with relabelled goals (Andrychowicz et al. 2017)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from napsp.data.episodes import Episodes, SparseReward, draw_steps
from napsp.errors import UserError
from napsp.settings import check_ranges


@dataclass(frozen=True)
class HERConfig:
    """Goals of the policy's update; what is left keeps the goal it was collected for."""

    relabel_ratio: float = 0.8
    """Share of future goals, k / (k + 1); 0.8 is k = 4."""
    other_goals_ratio: float = 0.0
    """Share of goals taken from other episodes, desired and achieved ones in equal parts."""

    def __post_init__(self) -> None:
        check_ranges(self, relabel_ratio=(0, 1), other_goals_ratio=(0, 1))
        if self.relabel_ratio + self.other_goals_ratio > 1:
            raise UserError(
                f"relabel_ratio {self.relabel_ratio} and other_goals_ratio {self.other_goals_ratio} exceed 1 together"
            )


@dataclass(frozen=True)
class Transitions:
    """Goal-relabelled transitions for the policy update; ``rewards`` are the sparse ones."""

    observations: np.ndarray
    actions: np.ndarray
    next_observations: np.ndarray
    next_achieved: np.ndarray
    goals: np.ndarray
    rewards: np.ndarray
    steps_between: np.ndarray
    """Steps to the future state whose goal it is; +inf for goals that come from elsewhere."""
    after: np.ndarray
    """Achieved goals a step after that future state; NaN for goals from elsewhere, and where the episode ends there."""
    ended: np.ndarray
    """Share of all later reward that is lost because nothing follows the next state: 0 where it ended at the goal, 1
    where it ended elsewhere, NaN where the world goes on, as it does beyond a time limit."""


def sample_relabelled(
    episodes: Episodes,
    n: int,
    config: HERConfig,
    sparse_reward: SparseReward,
    rng: np.random.Generator,
) -> Transitions:
    """Draw n transitions; HER replaces the goal of a share of them.

    Of ``config.relabel_ratio`` the new goal is "future": achieved at a step later than the
    transition's start, its own next state included. Of ``config.other_goals_ratio`` it is what
    another episode wanted or achieved, which most often stays unreached: with future goals
    alone, the values of goals that ask for more than the episode did are never corrected
    downwards. ``sparse_reward(achieved_goals, goals)`` gives 0 / -1 rewards ``(n,)``.
    """
    episode, t = draw_steps(episodes, n, rng)
    length = episodes.lengths[episode]
    future = rng.integers(t + 1, length + 1)
    goals = episodes.desired_goals[episode]  # a copy, as rows are picked
    chance = rng.random(n)
    relabel = chance < config.relabel_ratio
    goals[relabel] = episodes.achieved_goals[episode[relabel], future[relabel]]
    steps_between = np.where(relabel, future - t, np.inf).astype(np.float32)
    after = episodes.achieved_goals[episode, np.minimum(future + 1, length)]
    after[~relabel | (future == length)] = np.nan
    if config.other_goals_ratio:
        other = np.flatnonzero(chance > 1.0 - config.other_goals_ratio)
        wanted, achieved = other[::2], other[1::2]
        goals[wanted] = episodes.desired_goals[rng.integers(len(episodes), size=len(wanted))]
        theirs = rng.integers(len(episodes), size=len(achieved))
        n_states = episodes.actions.shape[1] + 1 if episodes.whole else episodes.lengths[theirs] + 1
        goals[achieved] = episodes.achieved_goals[theirs, rng.integers(n_states, size=len(achieved))]
    next_achieved = episodes.achieved_goals[episode, t + 1]
    rewards = sparse_reward(next_achieved, goals)
    return Transitions(
        observations=episodes.observations[episode, t],
        actions=episodes.actions[episode, t],
        next_observations=episodes.observations[episode, t + 1],
        next_achieved=next_achieved,
        goals=goals,
        rewards=rewards,
        steps_between=steps_between,
        after=after,
        ended=_ended(episodes, episode, t, rewards == 0),
    )


def _ended(episodes: Episodes, episode: np.ndarray, t: np.ndarray, arrived: np.ndarray) -> np.ndarray:
    """As :class:`Transitions` has it, for steps t of episodes ``(n,)`` and whether each leads to its goal.

    An environment that terminates an episode at its desired goal would have done so at any other that had been desired:
    there, arriving is the end, and its own goal is no end on the way to another. One that terminates elsewhere, by a
    fall say, ends the way to every goal.
    """
    ended = np.full(len(t), np.nan, np.float32)
    if episodes.arriving_ends:
        ended[arrived] = 0.0
    lost = episodes.lost(episode, t)
    ended[lost] = np.where(arrived[lost], 0.0, 1.0)
    return ended
