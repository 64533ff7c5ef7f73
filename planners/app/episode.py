"""What a planned episode leaves: one record per control step, and figures of the whole."""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields

import numpy as np


@dataclass(frozen=True)
class Step:
    """One control step; the fields are the columns of ``steps.csv``.

    Attributes:
        cost: of the executed plan, in steps, rolled out alone; +inf if it diverged.
        steps_to_go: the cost's estimate at the state the action led to.
        effective_samples: how many samples the planner's update really used.
        effective_share: the same as a share of the last refinement's samples.
        plan_ms: milliseconds of the plan call.
        smoothing_ms: the part of it that went into smoothing.
        gap: straight line from the state the action led to to the goal, metres in the world.
    """

    cost: float
    steps_to_go: float
    effective_samples: float
    effective_share: float
    plan_ms: float
    smoothing_ms: float
    gap: float


COLUMNS = ("episode", "step", *(field.name for field in fields(Step)))


@dataclass(frozen=True)
class EpisodeResult:
    """One planned episode of T control steps.

    Attributes:
        seed: seed of start and goal.
        success: at the goal in the last step.
        first_hit: control steps until the goal was first reached; None if never.
        steps: one record per control step, T.
        actions: what was executed, ``(T, A)``.
        achieved_goals: the way that was taken, ``(T + 1, G)``.
        desired_goal: where to, ``(G,)``.
        action_rate: mean squared change from one action to the next.
        jerk: root mean square of the end effector's jerk, m/s^3 (claw: of its joints, rad/s^3; tasks that
            this package does not know: of the first three coordinates of the achieved goal, where nobody knows how
            long a control step lasts per step^3).
        seconds: wall time of the episode.
    """

    seed: int
    success: bool
    first_hit: int | None
    steps: list[Step]
    actions: np.ndarray
    achieved_goals: np.ndarray
    desired_goal: np.ndarray
    action_rate: float
    jerk: float
    seconds: float

    def column(self, name: str) -> np.ndarray:
        """One field of all steps, ``(T,)``."""
        return np.array([getattr(step, name) for step in self.steps])

    @property
    def plan_ms(self) -> np.ndarray:
        """Milliseconds of each plan call, ``(T,)``."""
        return self.column("plan_ms")

    @property
    def smoothing_ms(self) -> np.ndarray:
        """The part of them that went into smoothing, ``(T,)``."""
        return self.column("smoothing_ms")

    @property
    def final_gap(self) -> float:
        """Straight-line gap to the goal at the end, metres in the world."""
        return self.steps[-1].gap

    def rows(self, episode: int) -> list[tuple[str, ...]]:
        """Its rows of ``steps.csv``, as the ``episode``-th of a run; steps count from 1."""
        return [(str(episode), str(t), *(f"{x:.5g}" for x in astuple(step))) for t, step in enumerate(self.steps, 1)]
