"""The scene in the browser: the robot, the goal to drag, the sampled plans coloured by cost, the executed path."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import viser  # pyright: ignore[reportMissingImports] - an extra
from mjviser import ViserMujocoScene  # pyright: ignore[reportMissingImports] - an extra

from mpc.controller import Plan
from planners.app.studio.camera import look
from planners.app.studio.field import Field
from planners.app.studio.goal import free_axes, goal_at
from planners.app.studio.trial import Scenery
from planners.app.video import SHOWN_PLANS, model_to_draw, plan_color

GREEN, RED = (26, 191, 51), (200, 20, 30)
HIDDEN_GROUP = 5  # shapes of this group are not shown
HANDLE = 4.0  # length of the goal's handles, in its radii
IN_HAND = 1.0  # seconds after a dragged goal was moved last
CATCH_UP = 0.5  # seconds that a motion between two control steps is drawn over at most


class Scene:
    """Draws one session; another session needs another one.

    Args:
        server: the page.
        first: what is to be seen.
        on_goal: called with the goal ``(G,)`` when it is dragged.
    """

    def __init__(self, server: viser.ViserServer, first: Scenery, on_goal: Callable[[np.ndarray], Any]) -> None:
        self.session = first.session
        self._server, self._world, self._on_goal = server, first.session.env.unwrapped, on_goal
        server.scene.reset()
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(
            cast_shadow=False
        )  # shadows cost browsers without a GPU most of their time
        self._model = model_to_draw(self._world)
        self._model.site_group[self._model.site_rgba[:, 3] == 0.0] = HIDDEN_GROUP  # sites know no transparency here
        if Field.drawable(first.session):  # seen through the floor
            planes = self._model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
            self._model.geom_type[planes], self._model.geom_rgba[planes, 3] = mujoco.mjtGeom.mjGEOM_BOX, 0.0
        self._add_wall()
        self._data = mujoco.MjData(self._model)
        self._robot = ViserMujocoScene(server, self._model, num_envs=1)
        self._robot.camera_tracking_enabled = False
        self._before, self._now = first, first
        self._width, self._dragged = self._thickness(), 0.0
        self._handle = self._add_goal(first)
        empty = np.zeros((0, 2, 3), np.float32)
        self._plans = server.scene.add_line_segments(
            "/plans", empty, np.zeros((0, 2, 3), np.uint8), thickness=self._width
        )
        self._way = server.scene.add_line_segments("/way", empty, RED, thickness=2.0 * self._width)
        self._field = Field(server, first.session) if Field.drawable(first.session) else None
        self._drawn: Scenery | None = None
        look(server, self._world, self._model)

    def draw(self, newest: Scenery) -> None:
        """Show what is to be seen now. Between control steps the motion from one to the next is filled in."""
        if newest is not self._now:
            self._before, self._now = self._now, newest
        self._pose()
        with self._server.atomic():
            self._robot.update_from_mjdata(self._data)
            if newest is not self._drawn:
                self._draw_plans(newest.plan)
                self._draw_way(newest)
        self._show_goal(newest.goal)
        if self._field is not None:
            self._field.draw(newest.goal)
        self._drawn = newest

    def _pose(self) -> None:
        """Where things are: on the way from the last control step to the newest, as long as that one took."""
        before, now = self._before, self._now
        took = min(now.at - before.at, CATCH_UP)
        share = min(1.0, (time.monotonic() - now.at) / took) if took > 0 and now.number == before.number + 1 else 1.0
        change = np.empty(self._model.nv)
        mujoco.mj_differentiatePos(self._model, change, 1.0, before.qpos, now.qpos)
        self._data.qpos[:] = before.qpos
        mujoco.mj_integratePos(self._model, self._data.qpos, change, share)
        mocap = before.mocap + share * (now.mocap - before.mocap)
        self._data.mocap_pos[:], self._data.mocap_quat[:] = mocap[:, :3], mocap[:, 3:]
        mujoco.mj_kinematics(self._model, self._data)

    def _thickness(self) -> float:
        return 0.004 * max(1.0, float(self._model.stat.extent) / 2.0)

    def _add_wall(self) -> None:
        """Draw a wall apart: merged into the scene's meshes it would not be translucent."""
        wall = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_GEOM, "wall")
        if wall < 0 or self._model.geom_type[wall] != mujoco.mjtGeom.mjGEOM_BOX:
            return
        data = mujoco.MjData(self._model)
        mujoco.mj_kinematics(self._model, data)
        red, green, blue, opacity = self._model.geom_rgba[wall].tolist()
        self._server.scene.add_box(
            "/wall",
            color=(red, green, blue),
            dimensions=tuple(2.0 * self._model.geom_size[wall]),
            opacity=opacity,
            position=data.geom_xpos[wall],
            cast_shadow=False,
        )
        self._model.geom_rgba[wall, 3] = 0.0

    def _add_goal(self, first: Scenery) -> Any:
        axes, radius = free_axes(self._world, first.goal), float(self._world.goal_radius)
        place = self._world.goal_positions(first.goal)
        scene = self._server.scene
        handle: Any = scene.add_frame("/goal", show_axes=False, position=place)
        if axes is not None:  # else it is a picture only
            handle = scene.add_transform_controls(
                "/goal",
                scale=HANDLE * radius,
                active_axes=axes,
                disable_sliders=True,
                disable_rotations=True,
                depth_test=False,
                position=place,
            )

            @handle.on_update
            def _(event: Any) -> None:
                self._dragged = time.monotonic()
                self._on_goal(goal_at(self._world, self._now.goal, np.array(event.target.position)))

        scene.add_icosphere("/goal/middle", 0.35 * radius, color=GREEN)
        scene.add_icosphere("/goal/within", radius, color=GREEN, opacity=0.2)
        return handle

    def _show_goal(self, goal: np.ndarray) -> None:
        place = self._world.goal_positions(goal)
        if time.monotonic() - self._dragged < IN_HAND:
            return  # what is simulated is a little behind the hand
        if not np.allclose(place, self._handle.position, atol=1e-6):
            self._handle.position = place

    def _draw_plans(self, plan: Plan | None) -> None:
        self._plans.visible = plan is not None
        if plan is None:
            return
        order = plan.cheapest(SHOWN_PLANS)
        points = self._world.goal_positions(plan.trajectories.achieved_goals[order])  # (N, n, 3)
        lines = np.stack([points[:, :-1], points[:, 1:]], axis=2)
        # Browsers take a line's colours, unlike one colour for all lines, for linear light.
        colors = [np.power(plan_color(rank / max(1, len(order) - 1))[:3], 2.2) for rank in range(len(order))]
        self._plans.points = lines.reshape(-1, 2, 3).astype(np.float32)
        shown = np.broadcast_to(np.array(colors)[:, None, None], lines.shape) if len(order) else lines
        self._plans.colors = (255 * shown).reshape(-1, 2, 3).astype(np.uint8)
        self._plans.visible = lines.size > 0

    def _draw_way(self, newest: Scenery) -> None:
        points = self._world.goal_positions(newest.way)
        self._way.visible = len(points) > 1
        if len(points) > 1:
            self._way.points = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
