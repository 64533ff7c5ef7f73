"""The column of a row that says how it was planned."""

from __future__ import annotations

import json
from typing import Any

from planners.app.config import PlanConfig

COLUMN = "planner_config"


def column(config: PlanConfig[Any] | None) -> str:
    """The configuration as compact JSON, what differs from the planner's defaults; empty where nothing was planned."""
    return "" if config is None else json.dumps(config.identity(), sort_keys=True, separators=(",", ":"))
