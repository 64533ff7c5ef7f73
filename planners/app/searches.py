"""The searches that can be planned with: a new one is a file of its own and a line here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from mpc.smoothing.config import SmoothingConfig
from planners.cem import CEM, CEMConfig
from planners.icem import ICEM, ICEMConfig
from planners.mppi import MPPI, MPPIConfig
from planners.predictive_sampling import PredictiveSampling, PredictiveSamplingConfig
from planners.smooth import Held, HeldConfig

if TYPE_CHECKING:  # names of searches are asked for before torch is
    from mpc.controller import Planner


class SearchConfig(Protocol):
    """How to search: a frozen dataclass beside the search, whose fields are the options ``--search.NAME``."""

    @property
    def samples(self) -> int:
        """N, plans per refinement."""
        ...

    @property
    def refinements(self) -> int:
        """Rounds of sampling per plan."""
        ...

    def least_samples(self, n_proposals: int) -> int:
        """Plans that are tried whatever the noise, and one with noise: with fewer there is no search."""
        ...


@dataclass(frozen=True)
class Search:
    """A search.

    Attributes:
        kind: makes it from K knots, U controls and its configuration.
        config: class of the configuration; its values are the defaults.
        smooth: how its plans are smoothed unless the user says otherwise; None: not at all.
    """

    kind: Callable[[int, int, Any], Planner]
    config: Callable[..., SearchConfig]
    smooth: SmoothingConfig | None = None


ALONE = SmoothingConfig(multiples=(1.0,), choice=1.0, rounds=3, accept="better")
"""The smoothing layer without a search has to find the way as well."""

SEARCHES: dict[str, Search] = {
    "mppi": Search(MPPI, MPPIConfig),
    "cem": Search(CEM, CEMConfig),
    "icem": Search(ICEM, ICEMConfig),
    "predictive_sampling": Search(PredictiveSampling, PredictiveSamplingConfig),
    "smooth": Search(Held, HeldConfig, ALONE),
}
"""By the name of the command, ``python -m planners.NAME``."""
