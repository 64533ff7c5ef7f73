"""How to search: sampling planners in numpy. Imports next to nothing, so that `python -m planners.NAME` is clean."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import napsp  # noqa: F401 - a line for Ctrl-C

if TYPE_CHECKING:
    from planners.app.library import controller

__all__ = ["controller"]


def __getattr__(name: str) -> Any:
    """Import what plans from a loop of one's own when it is asked for."""
    if name == "controller":
        from planners.app.library import controller

        return controller
    raise AttributeError(f"module 'planners' has no attribute {name!r}")
