"""Where a task is looked at from, in the browser: as in its videos."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

if TYPE_CHECKING:
    import viser  # pyright: ignore[reportMissingImports] - an extra

FIELD_OF_VIEW = 45.0  # degrees from bottom to top, MuJoCo's own


def viewpoint(world: Any, model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Where the camera stands and a point that it looks at, each ``(3,)`` in metres.

    Args:
        world: a task, whose attribute ``camera`` names a camera of its model or is one; without it the model's own.
        model: the task's.
    """
    camera = getattr(world, "camera", None)
    if isinstance(camera, str):
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        number = model.camera(camera).id
        position, ahead = data.cam_xpos[number], -data.cam_xmat[number].reshape(3, 3)[:, 2]
        if ahead[2] < -0.9:  # from straight above an orbit has no upright; a little from the south it has
            ahead = np.array([0.0, 0.5, -0.85])
            distance = 1.15 * position[2]
            return -distance * ahead + [position[0], position[1], 0.0], np.array([position[0], position[1], 0.0])
        return position.copy(), position + ahead * float(model.stat.extent)
    if camera is None:
        camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(model, camera)
    azimuth, elevation = np.radians([camera.azimuth, camera.elevation])
    ahead = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    return camera.lookat - camera.distance * ahead, np.array(camera.lookat)


def look(server: viser.ViserServer, world: Any, model: mujoco.MjModel) -> None:
    """Put the camera of every page, and of those that open later, there."""
    position, at = (tuple(map(float, place)) for place in viewpoint(world, model))
    server.initial_camera.position, server.initial_camera.look_at = position, at
    server.initial_camera.up, server.initial_camera.fov = (0.0, 0.0, 1.0), float(np.radians(FIELD_OF_VIEW))
    for client in server.get_clients().values():
        with client.atomic():
            client.camera.up_direction = (0.0, 0.0, 1.0)
            client.camera.fov = float(np.radians(FIELD_OF_VIEW))
            client.camera.position, client.camera.look_at = position, at
