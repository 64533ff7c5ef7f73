"""What each planning command asks beside the options that all share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from planners.app.options import PlanOptions


@dataclass(frozen=True)
class MPPIOptions(PlanOptions):
    """Plan with MPPI: the exponentially weighted mean of noisy plans."""

    noise_scale: float = 0.8
    """Standard deviation of the sampled noise; actions lie in [-1, 1]."""
    noise_correlation: float = 0.6
    """Correlation of the noise between neighbouring knots."""
    temperature: float = 0.2
    """MPPI's lambda, in standard deviations of the sampled costs."""

    @property
    def least_samples(self) -> int:
        """The mean, the best plan, proposals, and one with noise."""
        return 2 + self.n_proposals + 1


@dataclass(frozen=True)
class CEMOptions(PlanOptions):
    """Plan with the cross-entropy method: a Gaussian refitted to the best samples."""

    samples: int = 21
    """Plans per refinement."""
    refinements: int = 3
    """Rounds of sampling per plan."""
    elites: int = 6
    """How many of the best plans the Gaussian is fitted to."""
    noise_scale: float = 0.8
    """Standard deviation before the first refinement; actions lie in [-1, 1]."""
    min_noise_scale: float = 0.05
    """The deviation does not shrink below this."""
    momentum: float = 0.1
    """Weight of the old mean and deviation in the new ones."""

    @property
    def least_samples(self) -> int:
        """The mean, proposals, and one with noise."""
        return 1 + self.n_proposals + 1


@dataclass(frozen=True)
class ICEMOptions(PlanOptions):
    """Plan with iCEM: the cross-entropy method with coloured noise and kept elites."""

    samples: int = 26
    """Plans in the first refinement; later ones get fewer (--decay)."""
    refinements: int = 3
    """Rounds of sampling per plan."""
    decay: float = 1.25
    """Factor between the samples of one refinement and the next."""
    elites: int = 6
    """How many of the best plans the Gaussian is fitted to."""
    kept: float = 0.3
    """Share of the elites that is tried again, in the next refinement and the next step."""
    noise_scale: float = 0.5
    """Standard deviation before the first refinement; actions lie in [-1, 1]."""
    noise_exponent: float = 3.0
    """How fast the noise's power falls with frequency; 0 is white noise."""
    momentum: float = 0.1
    """Weight of the old mean and deviation in the new ones."""

    @property
    def least_samples(self) -> int:
        """Kept elites, proposals (in the first refinement) and the mean (in the last), and one with noise."""
        others = self.n_proposals + 1 if self.refinements == 1 else max(self.n_proposals, 1)
        return math.ceil(self.kept * self.elites) + others + 1


@dataclass(frozen=True)
class PredictiveSamplingOptions(PlanOptions):
    """Plan with predictive sampling: noise around the best plan so far."""

    noise_scale: float = 0.8
    """Standard deviation of the sampled noise; actions lie in [-1, 1]."""
    noise_correlation: float = 0.6
    """Correlation of the noise between neighbouring knots."""

    @property
    def least_samples(self) -> int:
        """The plan, proposals, and one with noise."""
        return 1 + self.n_proposals + 1


@dataclass(frozen=True)
class SmoothOptions(PlanOptions):
    """Plan with the smoothing layer alone: it improves one plan from step to step, without any search."""

    start: Literal["policy", "zero"] = "policy"
    """What is smoothed: the cheaper of the last plan and the policy's own rollout, or the last plan only, which
    starts at zero."""
    samples: int = 2
    """Not used: the plan is compared with what --start and the two --proposals options bring."""
    smooth: bool = True
    """Smoothing is what this command does."""
    smooth_multiples: tuple[float, ...] | None = (1.0,)
    """Solve with changes weighed so many times as heavily, and verify all answers together."""
    smooth_choice: float | None = 1.0
    """Weight of smoothness against the planner's own cost in choosing between plans; 1 is the problem's own."""
    smooth_rounds: int = 3
    """Linearise, solve and verify so many times per plan."""
    smooth_accept: Literal["smoother", "better"] = "better"
    """As for the other planners; without a search, the layer has to find the way as well."""


OPTIONS: dict[str, type[PlanOptions]] = {
    "mppi": MPPIOptions,
    "cem": CEMOptions,
    "icem": ICEMOptions,
    "predictive_sampling": PredictiveSamplingOptions,
    "smooth": SmoothOptions,
}
