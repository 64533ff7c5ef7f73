"""Choosing an off-screen renderer before mujoco is imported."""

from __future__ import annotations

import ctypes.util
import os


def choose_gl() -> None:
    """Set MUJOCO_GL where nobody chose and there is no display: EGL, else OSMesa, else none.

    mujoco reads the variable once, on import, and without a display its default fails.
    """
    if "MUJOCO_GL" in os.environ or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return
    for library, name in (("EGL", "egl"), ("OSMesa", "osmesa")):
        if ctypes.util.find_library(library):
            os.environ["MUJOCO_GL"] = name
            return
    os.environ["MUJOCO_GL"] = "disable"
