"""Settings of the smoothing layer; without CasADi, so that a command can ask for them and never use it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from napsp.errors import UserError
from napsp.settings import check_choice, check_ranges


@dataclass(frozen=True)
class SmoothingConfig:
    """Smooth every plan with CasADi, the learned distance as cost (--smooth); roughness is weighed in steps."""

    rate: float = 1.0
    """Weight of the mean squared change from one action to the next (times the horizon)."""
    jerk: float = 0.3
    """Weight of squared changes of those changes."""
    effort: float = 0.01
    """Weight of squared actions."""
    distance: float = 1.0
    """Weight of the learned distance."""
    multiples: tuple[float, ...] | None = None
    """Solve with rate and jerk weighed so many times as heavily, and verify all answers together; default by task
    (0.3, 1, 3 and 10; 1 for the mazes, where four solutions would take longer than the search)."""
    choice: float | None = None
    """Weight of roughness against the planner's own cost in choosing between plans that cost no more than the sampled
    one: among verified answers, and between the plan so far and what may replace it. The smaller, the rarer a plan is
    replaced. Default 10 with several multiples, else 1."""
    along: bool = True
    """Read the distance at the states where the planner's cost reads it (--where); otherwise at the end only."""
    trust: float = 0.3
    """How far an action may be moved at first; adapts from step to step."""
    rounds: int = 1
    """Linearise, solve and verify so many times per plan; 0 only chooses between the sampled plan and the last one."""
    tolerance: float = 0.0
    """Smoothing may raise the planner's cost by so many steps."""
    accept: Literal["smoother", "better"] = "smoother"
    """What a smoothed plan needs besides a cost that did not rise and a lower sum of cost and choice times roughness: a
    lower action rate as well, or nothing more (for the layer alone, which has to find the way as well)."""
    step: float = 0.1
    """Change of an action for the finite differences that linearise the simulator."""
    solver: Literal["qp", "ipopt"] = "qp"
    """Quadratic programs (daqp), or IPOPT: the same answers in several times the time."""

    def resolved(self, multiples: tuple[float, ...] = (1.0,)) -> SmoothingConfig:
        """With numbers where None stands for a default; ``multiples`` is the task's."""
        chosen = self.multiples or multiples
        usual = 10.0 if len(chosen) > 1 else 1.0
        return replace(self, multiples=chosen, choice=usual if self.choice is None else self.choice)

    def __post_init__(self) -> None:
        check_ranges(self, rate=(0, 1e6), jerk=(0, 1e6), effort=(1e-6, 1e6), distance=(0, 1e6), choice=(1e-6, 1e6))
        check_ranges(self, trust=(0.05, 1), rounds=(0, 100), tolerance=(0, 1e6), step=(1e-4, 0.5))
        check_choice(self, accept=("smoother", "better"), solver=("qp", "ipopt"))
        many = self.multiples
        if many is not None and not (many and all(0 < multiple <= 1e6 for multiple in many)):  # false for NaN as well
            raise UserError(f"multiples is {many}; give one or more positive numbers of at most 1e+06")
