"""How a row was planned: the column that says so, and a search that simulates a number of plans."""

from __future__ import annotations

import json
from typing import Any

from napsp.errors import UserError
from planners.app.config import PlanConfig

COLUMN = "planner_config"


def column(config: PlanConfig[Any] | None) -> str:
    """The configuration as compact JSON, what differs from the planner's defaults; empty where nothing was planned."""
    return "" if config is None else json.dumps(config.identity(), sort_keys=True, separators=(",", ":"))


def of_budget(planner: str, budget: int, changes: dict[str, Any]) -> PlanConfig[Any]:
    """A search that simulates about ``budget`` plans per control step, over all its refinements.

    Args:
        planner: name of the search.
        budget: plans per control step; iCEM's rounds shrink, so 32 are 13, 10 and 8.
        changes: of options of the planner, but for samples and elites.

    Raises:
        UserError: the search needs more plans.
    """
    search: Any = PlanConfig.of(planner, changes).search
    shares = sum(getattr(search, "decay", 1.0) ** -i for i in range(search.refinements))
    samples = max(1, round(budget / shares))
    sizes: dict[str, Any] = {"search.samples": samples}
    if hasattr(search, "elites"):
        sizes["search.elites"] = min(search.elites, max(2, samples // 4))
    try:
        return PlanConfig.of(planner, {**changes, **sizes})
    except (UserError, ValueError) as error:
        raise UserError(f"a budget of {budget} is too small for {planner}: {error}") from None
