"""Choosing how to draw, off-screen or in a window, before mujoco is imported."""

from __future__ import annotations

import ctypes.util
import os
import subprocess
import sys
import warnings

from napsp.errors import UserError

PROBE = "import mujoco; mujoco.GLContext(16, 16).make_current()"


def choose_gl() -> None:
    """Set MUJOCO_GL where nobody chose and there is no display: EGL, else OSMesa, else none.

    mujoco reads the variable once, on import, and without a display its default fails.
    """
    if "MUJOCO_GL" in os.environ or _names_display():
        return
    names = [name for library, name in (("EGL", "egl"), ("OSMesa", "osmesa")) if ctypes.util.find_library(library)]
    if len(names) > 1 and not _works("egl"):  # the EGL library may be there without a device
        names.remove("egl")
    os.environ["MUJOCO_GL"] = names[0] if names else "disable"


def require_display() -> None:
    """Make sure that a window can be opened.

    Raises:
        UserError: there is no display, or it does not answer.
    """
    if not _names_display():
        raise UserError("--render human needs a display (DISPLAY or WAYLAND_DISPLAY); leave it out and watch the video")
    os.environ["MUJOCO_GL"] = "glfw"  # what the window draws with; another choice concerns off-screen frames only
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # glfw reports as a warning what the error below says
        answers = glfw.init() and glfw.get_primary_monitor()
    if not answers:
        name = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        raise UserError(f"--render human needs a display, and {name} does not answer; leave it out and watch the video")


def why_no_pictures(error: Exception) -> str:
    """What went wrong where mujoco can not draw off-screen, and what would help.

    In a notebook or a program of one's own mujoco is mostly imported before a command chooses how to draw.
    """
    import mujoco

    context = getattr(mujoco, "GLContext", None)  # none if nothing was to be drawn
    chosen = os.environ.get("MUJOCO_GL") == "glfw"
    if context is not None and context.__module__ == "mujoco.glfw" and not chosen and not _names_display():
        return "mujoco was imported when nothing said how to draw without a display; set MUJOCO_GL=egl or osmesa before"
    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    return f"no off-screen OpenGL here ({reason}); install libosmesa6 or libegl1"


def _names_display() -> bool:
    # Elsewhere than on Linux there is one without being named.
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def _works(name: str) -> bool:
    command = [sys.executable, "-c", PROBE]
    return subprocess.run(command, env={**os.environ, "MUJOCO_GL": name}, capture_output=True).returncode == 0
