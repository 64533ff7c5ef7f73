"""What a time was taken on: rows of other machines are no ratio."""

from __future__ import annotations

import platform
from pathlib import Path
from typing import Any

import mujoco

from mpc.rollout import available_cores
from napsp.storage.revision import git_revision


def machine() -> dict[str, Any]:
    """Columns of a timed row that say what ran where."""
    versions = {"mujoco": mujoco.__version__, "revision": git_revision()}
    return versions | {"cores": available_cores(), "processor": processor()}


def processor(told: Path = Path("/proc/cpuinfo")) -> str:
    """What calculates, and whether it has units for bfloat16 matrices, with which some trainings take half as long."""
    if not told.is_file():
        return platform.processor() or platform.machine()
    lines = [line.partition(":") for line in told.read_text().splitlines()]
    words = {name.strip(): value.strip() for name, _, value in lines}
    name = words.get("model name") or platform.machine()
    return name + (" with AMX" if "amx_bf16" in words.get("flags", "").split() else "")
