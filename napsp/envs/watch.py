"""Has a task changed? It may randomise its model at a reset, or move a wall in the middle of an episode."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

# Pictures, names, and what the compiler derives; mesh vertices are megabytes, and geoms refer to the whole mesh anyway.
UNWATCHED = (
    "name", "mesh_", "tex_", "mat_", "cam_", "light_", "skin_", "bvh_", "oct_", "text_", "tuple_", "numeric_", "key_",
    "paths", "M_", "D_", "B_", "map",
)  # fmt: skip


class Watched:
    """Remembers the numbers of a model that physics reads."""

    def __init__(self, model: mujoco.MjModel) -> None:
        named = {name: getattr(model, name) for name in dir(model) if not name.startswith(("_", *UNWATCHED))}
        options: Any = model.opt
        kept = {name: getattr(options, name) for name in dir(options) if not name.startswith("_")}
        self._options = options
        # Arrays are views that live as long as the model; numbers are read anew.
        self._arrays = [a for a in (*named.values(), *kept.values()) if isinstance(a, np.ndarray) and a.size]
        self._numbers = [name for name, value in kept.items() if isinstance(value, int | float)]
        self._seen = self._read()

    def changed(self) -> bool:
        """Whether anything is different from the last time somebody asked."""
        now, before = self._read(), self._seen
        self._seen = now
        return now != before

    def _read(self) -> tuple[bytes, list[float]]:
        numbers = [getattr(self._options, name) for name in self._numbers]
        return b"".join([values.tobytes() for values in self._arrays]), numbers


class WatchedDynamics:
    """Remembers the attributes of dynamics: a task may compile another model, or give its wind another strength."""

    def __init__(self, dynamics: Any) -> None:
        self._dynamics = dynamics
        self._seen = self._read()

    def changed(self) -> bool:
        """Whether an attribute has been set anew since then. What is inside of one is not looked at."""
        now = self._read()
        return len(now) != len(self._seen) or any(a is not b for a, b in zip(now, self._seen, strict=True))

    def _read(self) -> list[Any]:
        return list(getattr(self._dynamics, "__dict__", {}).values())


def watched(dynamics: Any) -> list[Watched | WatchedDynamics]:
    """What tells whether dynamics have changed: their attributes, and the numbers of their model if they have one."""
    model = [] if dynamics.model is None else [Watched(dynamics.model)]
    return [*model, WatchedDynamics(dynamics)]
