"""The labels of eq. 4a and 4b, as pure functions, and their options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from napsp.settings import MANY, check_choice, check_ranges


@dataclass(frozen=True)
class TemporalConfig:
    """Labels of eq. 4a."""

    first_arrival: bool = False
    """Label a pair with the steps to the first state after s_i that the task counts as being at its goal,
    not with j - i, which takes waiting at a goal for distance to it. Beyond the paper; not for sparse."""
    ddl_window: int = 20
    """Most recent episodes that the on-policy regression of ddl sees."""

    def __post_init__(self) -> None:
        check_ranges(self, ddl_window=(1, MANY))


@dataclass(frozen=True)
class TriangularConfig:
    """Labels and weight of eq. 4b."""

    weight: float = 1.0
    """Weight of eq. 4b against eq. 4a; 1 is the paper's plain sum."""
    mean: Literal["sampled", "passed"] = "sampled"
    """Average eq. 4b over all sampled tuples (Algorithm 1: the others "do nothing") or over
    those that pass the test (eq. 4b: a handful of tuples then weighs as much as a full batch)."""
    cap: bool = True
    """Clip the hypotenuse at the episode length T; without it the loss diverges."""
    require_reached_waypoint: bool = True
    """Algorithm 1, line 13: N(s_j, a_j, s_g) > 0. False follows the text of eq. 4b."""

    def __post_init__(self) -> None:
        check_ranges(self, weight=(0, MANY))
        check_choice(self, mean=("sampled", "passed"))


@dataclass(frozen=True)
class BootstrapConfig:
    """Labels of method plus."""

    pessimism: Literal["largest", "mean", "smallest"] = "largest"
    """Which of the K slow distances of the next state goes into a label."""
    bound: bool = True
    """No label exceeds the steps after which the same episode was at the goal."""
    stay: float = 0.5
    """Where actions do not decide at once how the achieved goal changes (``graph.control``), arrivals should last: this
    share of the way back is added where the next state is at the goal and the policy leaves it again, and j - i bounds
    a label only if the episode was still there a step later. 0 asks for no more than passing through."""

    def __post_init__(self) -> None:
        check_choice(self, pessimism=("largest", "mean", "smallest"))
        check_ranges(self, stay=(0, 1))

    def reduce(self, members: Tensor) -> Tensor:
        """One distance ``(B,)`` from those of K networks ``(K, B)``."""
        return {"largest": members.amax, "mean": members.mean, "smallest": members.amin}[self.pessimism](0)


def one_step_label(
    arrived: Tensor,
    next_steps: Tensor,
    observed: Tensor,
    known: Tensor,
    length: float,
    stay: float = 0.0,
    ended: Tensor | None = None,
) -> Tensor:
    """Steps ``(B,)`` from a transition and what is known of the way on from its end; beyond the paper.

        1 + stay * (d_old(s_t+1) - 1)        where s_t+1 is at the goal, from which one step is least
        min(known, observed)                 where shortest paths over the replay lead there
        min(1 + d_old(s_t+1), observed)      elsewhere; both within [2, T], for one step was not enough
        1 or T                               where nothing follows s_t+1, which is at the goal or is not

    Args:
        arrived: whether s_t+1 is at the goal, bool ``(B,)``.
        next_steps: d_old(s_t+1, pi(s_t+1), g), ``(B,)``.
        observed: steps after which the same episode was at the goal, else +inf, ``(B,)``.
        known: 1 + steps of the graph, NaN where there is no path, ``(B,)``.
        length: T.
        stay: see :class:`BootstrapConfig`.
        ended: 0 where the episode ended at the goal, 1 where it ended elsewhere for good, NaN where the world goes on.
    """
    at_goal = 1.0 + stay * (next_steps.clamp(max=length) - 1.0).clamp(min=0.0)
    steps = torch.where(known.isnan(), 1.0 + next_steps, known)
    steps = torch.minimum(steps, observed)
    labels = torch.where(arrived, at_goal, steps.clamp(2.0, length))
    return labels if ended is None else torch.where(ended.isnan(), labels, 1.0 + ended * (length - 1.0))


def temporal_label(steps_between: Tensor, target_steps: Tensor, uncertainty: Tensor) -> Tensor:
    """min[j - i, d_old + U] in steps (eq. 4a); all ``(B,)``."""
    return torch.minimum(steps_between, target_steps + uncertainty)


def hypotenuse(first_leg: Tensor, second_leg: Tensor, cap: float | None) -> Tensor:
    """d*(s_i, a_i, s_g) = d(s_i, a_i, s_j) + d(s_j, a_j, s_g), capped (eq. 3); ``(B,)``."""
    total = first_leg + second_leg
    return total if cap is None else total.clamp(max=cap)
