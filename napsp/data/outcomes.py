"""Evaluation episodes, and what they came to."""

from __future__ import annotations

from dataclasses import dataclass

import gymnasium
import numpy as np

from napsp.data.collect import Actor, roll
from napsp.data.episodes import BLOWN, Episodes, concatenate
from napsp.settings import MANY, check_ranges
from napsp.statistics import describe, wilson_interval


@dataclass(frozen=True)
class EvaluationConfig:
    """Evaluations during training."""

    every: int = 50
    """Episodes between evaluations; each one also writes a checkpoint."""
    n_episodes: int = 20
    """Episodes per evaluation, on goals that all methods and seeds share."""

    def __post_init__(self) -> None:
        check_ranges(self, every=(1, MANY), n_episodes=(1, MANY))


@dataclass(frozen=True)
class Outcomes:
    """What E evaluation episodes came to.

    Attributes:
        reached: whether the goal is reached at s_1 .. s_T, bool ``(E, T)``; the last state of an episode that ended
            sooner counts up to there.
        gaps: Euclidean gap between achieved and desired goal at s_1 .. s_T, ``(E, T)``.
    """

    reached: np.ndarray
    gaps: np.ndarray

    def __repr__(self) -> str:
        """What they say, with 95 % Wilson intervals."""
        n, at_end = len(self.reached), int(self.reached[:, -1].sum())
        success = describe(self.success_rate, wilson_interval(at_end, n))
        return f"<{n} episodes: success {success}, at the goal in some step {self.any_success_rate:.2f}>"

    @property
    def success_rate(self) -> float:
        """Share of episodes at the goal in the last step."""
        return float(self.reached[:, -1].mean())

    @property
    def any_success_rate(self) -> float:
        """Share of episodes at the goal in some step."""
        return float(self.reached.any(1).mean())

    @property
    def first_hits(self) -> np.ndarray:
        """Steps until the goal is first reached, NaN where it never is, ``(E,)``."""
        steps = self.reached.argmax(1) + 1.0
        return np.where(self.reached.any(1), steps, np.nan)


def outcomes(env: gymnasium.Env, episodes: Episodes) -> Outcomes:
    """Judge episodes by the environment's own success test."""
    goals = np.repeat(episodes.desired_goals[:, None], episodes.actions.shape[1], axis=1)
    achieved = episodes.achieved_goals[:, 1:]
    reached = env.get_wrapper_attr("reached")(achieved, goals)
    # Nobody is at a goal after a blow-up, wherever the last good state was.
    reached = reached & (episodes.happened() | (episodes.endings != BLOWN)[:, None])
    return Outcomes(reached, np.linalg.norm(achieved - goals, axis=-1))


def evaluate(envs: list[gymnasium.Env], actor: Actor, seeds: list[int], length: int) -> tuple[Outcomes, Episodes]:
    """Run one episode per seed with a deterministic actor."""
    parts = []
    for start in range(0, len(seeds), len(envs)):
        chunk = seeds[start : start + len(envs)]
        parts.append(roll(envs[: len(chunk)], actor, chunk, length))
    episodes = concatenate(parts)
    return outcomes(envs[0], episodes), episodes
