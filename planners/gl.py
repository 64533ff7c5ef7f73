"""Choosing an off-screen renderer before mujoco is imported."""

from __future__ import annotations

import ctypes.util
import os
import subprocess
import sys

PROBE = "import mujoco; mujoco.GLContext(16, 16).make_current()"


def choose_gl() -> None:
    """Set MUJOCO_GL where nobody chose and there is no display: EGL, else OSMesa, else none.

    mujoco reads the variable once, on import, and without a display its default fails.
    """
    if "MUJOCO_GL" in os.environ or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return
    names = [name for library, name in (("EGL", "egl"), ("OSMesa", "osmesa")) if ctypes.util.find_library(library)]
    if len(names) > 1 and not _works("egl"):  # the EGL library may be there without a device
        names.remove("egl")
    os.environ["MUJOCO_GL"] = names[0] if names else "disable"


def _works(name: str) -> bool:
    command = [sys.executable, "-c", PROBE]
    return subprocess.run(command, env={**os.environ, "MUJOCO_GL": name}, capture_output=True).returncode == 0
