"""A video of planned episodes: the scene, the goal, and the sampled plans fanned out by cost."""

from __future__ import annotations

import copy
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mpc.controller import Plan
from planners.app.frames import Film, OwnFrames, caption, captioned
from planners.app.gl import why_no_pictures

WIDTH, HEIGHT = 640, 480
SHOWN_PLANS = 24
LINE_WIDTH = 0.002  # radius of a plan's line, seen from one metre
GOAL_COLOR = (0.1, 0.75, 0.2, 0.9)


def model_to_draw(world: Any) -> mujoco.MjModel:
    """A copy of a task's model with its own markers hidden and its wall translucent: goal and plans are drawn apart."""
    model = copy.copy(world.model)
    for geom in range(model.ngeom):
        if model.body_mocapid[model.geom_bodyid[geom]] >= 0:
            model.geom_rgba[geom, 3] = 0.0  # Fetch draws its mocap anchor as a large cross
    for site in range(model.nsite):
        if "target" in (mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SITE, site) or ""):
            model.site_rgba[site, 3] = 0.0  # stock goals; the goal is drawn here, with its radius
    wall = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "wall")
    if wall >= 0:
        model.geom_rgba[wall, 3] = 0.35  # the goal lies behind it
    return model


def plan_color(badness: float) -> tuple[float, float, float, float]:
    """Red, green, blue and opacity of a plan: blue at 0, the cheapest shown, to a faint red at 1, the dearest."""
    return 0.15 + 0.8 * badness, 0.35, 0.95 - 0.75 * badness, 0.9 - 0.6 * badness


def recorder(path: Path, env: Any) -> Video | OwnFrames:
    """What makes the video of an environment."""
    return OwnFrames(path, env) if env.unwrapped.model is None else Video(path, env.unwrapped)


class Video:
    """Writes frames to an MP4; without a working GL library it stays silent and says so once."""

    def __init__(self, path: Path, world: Any) -> None:
        self._world, self._film = world, Film(path)
        self._problem: str | None = None
        # Rendering must not touch the planner's world: everything here is a copy.
        self._model = model_to_draw(world)
        self._data = mujoco.MjData(self._model)
        size = self._model.vis.global_  # stock robots have a smaller buffer
        size.offwidth, size.offheight = max(size.offwidth, WIDTH), max(size.offheight, HEIGHT)
        self._renderer: Any = None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # glfw reports as warnings what the error is about
                self._renderer = mujoco.Renderer(self._model, HEIGHT, WIDTH)
        except Exception as error:
            self._problem = f"no video: {why_no_pictures(error)}"
        self._camera = self._make_camera()

    def _make_camera(self) -> Any:
        if hasattr(self._world, "camera"):
            return self._world.camera
        camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(self._model, camera)
        return camera

    def frame(self, observation: dict[str, np.ndarray], plan: Plan) -> None:
        """Add a frame of the world as it is before the plan's action is executed."""
        image = self.image(observation, plan)
        if image is None:
            return
        self._film.add(captioned(image, caption(self._world, observation, plan)))

    def image(self, observation: dict[str, np.ndarray], plan: Plan) -> np.ndarray | None:
        """Pixels ``(HEIGHT, WIDTH, 3)`` of the world as it is now, with goal and plans; None without OpenGL."""
        if self._renderer is None:
            return None
        state = mujoco.mjtState.mjSTATE_FULLPHYSICS
        values = np.empty(mujoco.mj_stateSize(self._model, state))
        mujoco.mj_getState(self._world.model, self._world.data, values, state)
        mujoco.mj_setState(self._model, self._data, values, state)
        mujoco.mj_forward(self._model, self._data)
        self._renderer.update_scene(self._data, self._camera)
        radius, goal = self._world.goal_radius, self._world.goal_positions(observation["desired_goal"])
        self._sphere(goal, 0.35 * radius, GOAL_COLOR)
        self._sphere(goal, radius, (*GOAL_COLOR[:3], 0.15))
        self._draw_plans(plan)
        return self._renderer.render()

    def _draw_plans(self, plan: Plan) -> None:
        order = plan.cheapest(SHOWN_PLANS)
        width = LINE_WIDTH * (self._camera.distance if isinstance(self._camera, mujoco.MjvCamera) else 1.0)
        for rank in range(len(order) - 1, -1, -1):  # the best on top
            badness = rank / max(1, len(order) - 1)
            color = plan_color(badness)
            points = self._world.goal_positions(plan.trajectories.achieved_goals[order[rank]])
            for start, end in pairwise(points):
                self._segment(start, end, width if rank else 2.0 * width, color)

    def _sphere(self, position: np.ndarray, radius: float, color: tuple[float, ...]) -> None:
        geom = self._next_geom()
        if geom is not None:
            kind, size = mujoco.mjtGeom.mjGEOM_SPHERE, np.array([radius, 0.0, 0.0])
            mujoco.mjv_initGeom(
                geom, kind, size, position.astype(float), np.eye(3).ravel(), np.array(color, np.float32)
            )

    def _segment(self, start: np.ndarray, end: np.ndarray, width: float, color: tuple[float, ...]) -> None:
        geom = self._next_geom()
        if geom is not None:
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE
            zeros = np.zeros(3)
            mujoco.mjv_initGeom(geom, kind, zeros, zeros, np.eye(3).ravel(), np.array(color, np.float32))
            mujoco.mjv_connector(geom, kind, width, start.astype(float), end.astype(float))

    def _next_geom(self) -> Any:
        scene = self._renderer.scene
        if scene.ngeom >= scene.maxgeom:
            return None
        scene.ngeom += 1
        return scene.geoms[scene.ngeom - 1]

    def close(self) -> str:
        """Finish the file; return the line to show the user."""
        if self._renderer is not None:
            self._renderer.close()
        return self._film.close() or self._problem or "no video: no frames"

    def abandon(self) -> None:
        """Let go of OpenGL and the encoder, and leave no file: the episode will not be finished."""
        if self._renderer is not None:
            self._renderer.close()
        self._film.abandon()
