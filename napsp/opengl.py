"""A MUJOCO_GL that does not work here must not stop what needs no picture."""

from __future__ import annotations

import os
import sys


def import_mujoco() -> None:
    """Import mujoco; where the MUJOCO_GL that was chosen makes that fail, say so and go on without pictures.

    mujoco loads its OpenGL library on import. Without MUJOCO_GL that can not fail, and nothing is imported here.
    """
    chosen = os.environ.get("MUJOCO_GL")
    if not chosen or "mujoco" in sys.modules:
        return
    try:
        import mujoco  # noqa: F401
    except Exception as error:  # whatever PyOpenGL makes of a library that is missing
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        print(
            f"MUJOCO_GL={chosen} does not work here ({reason}), so no pictures; unset it or install its library",
            file=sys.stderr,
        )
        os.environ["MUJOCO_GL"] = "disable"
