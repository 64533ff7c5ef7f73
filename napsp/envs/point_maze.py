"""A point mass in a house of four rooms (paper, section 6 "2D navigation", figures 1 and 4).

The rooms form a chain: lower left - upper left - upper right - lower right. Episodes start
in the lower left room, goals lie in the upper right one, and the straight line between the
two ends at the solid corner in the middle of the house.

        +-------+-------+        arena [-scale, scale]^2, metres
        |   UL     UR   |        doors 0.3*scale wide, far from the diagonal
        |       | goals |
        +-   ---+---   -+
        |   LL  |  LR   |
        | start |       |
        +-------+-------+
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from napsp.envs.open_loop import OpenLoopDynamics, OpenLoopEnv

if TYPE_CHECKING:
    from napsp.envs.geodesic import ShortestPaths

WALL_HALF_THICKNESS = 0.03
POINT_RADIUS = 0.05
# (centre x, centre y, half length x, half length y), in units of the scale.
INNER_WALLS = (
    (-0.95, 0.0, 0.05, 0.0),  # LL | UL, left of the door at x in [-0.9, -0.6]
    (-0.30, 0.0, 0.30, 0.0),
    (0.0, 0.30, 0.0, 0.30),  # UL | UR, below the door at y in [0.6, 0.9]
    (0.0, 0.95, 0.0, 0.05),
    (0.30, 0.0, 0.30, 0.0),  # LR | UR, left of the door at x in [0.6, 0.9]
    (0.95, 0.0, 0.05, 0.0),
    (0.0, -0.50, 0.0, 0.50),  # LL | LR, no door
)
OUTER_WALLS = ((0.0, -1.0, 1.0, 0.0), (0.0, 1.0, 1.0, 0.0), (-1.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 1.0))


def _build_model(scale: float) -> mujoco.MjSpec:
    walls = "\n".join(
        f'<geom type="box" pos="{x * scale} {y * scale} 0.08" rgba="0.35 0.38 0.45 1" '
        f'size="{hx * scale + WALL_HALF_THICKNESS} {hy * scale + WALL_HALF_THICKNESS} 0.08"/>'
        for x, y, hx, hy in INNER_WALLS + OUTER_WALLS
    )
    # Mass 1 kg, damping 10, gear 10: top speed 1 m/s per axis, time constant 0.1 s (one
    # control step). Damping takes the place of a velocity clip, so that nothing happens
    # between two physics steps and a whole horizon is one open-loop rollout.
    return mujoco.MjSpec.from_string(f"""
    <mujoco model="point_maze">
      <option timestep="0.01" gravity="0 0 0"/>
      <visual>
        <global offwidth="640" offheight="480"/>
        <headlight ambient="0.5 0.5 0.5" diffuse="0.5 0.5 0.5" specular="0 0 0"/>
      </visual>
      <default><geom condim="1" solref="0.02 1"/></default>
      <worldbody>
        <camera name="top" pos="0 0 {2.9 * scale}" fovy="45"/>
        <geom type="plane" size="{1.2 * scale} {1.2 * scale} 0.1" pos="0 0 0"
              rgba="0.93 0.93 0.9 1" contype="0" conaffinity="0"/>
        {walls}
        <body name="point" pos="0 0 {POINT_RADIUS}">
          <joint name="x" type="slide" axis="1 0 0" damping="10"/>
          <joint name="y" type="slide" axis="0 1 0" damping="10"/>
          <geom type="sphere" size="{POINT_RADIUS}" mass="1" rgba="0.1 0.35 0.8 1"/>
        </body>
      </worldbody>
      <actuator>
        <motor joint="x" gear="10" ctrllimited="true" ctrlrange="-1 1"/>
        <motor joint="y" gear="10" ctrllimited="true" ctrlrange="-1 1"/>
      </actuator>
    </mujoco>""")


class PointMazeDynamics(OpenLoopDynamics):
    """Force control of the point: a control row is the action, features are (x, y, vx, vy)."""

    substeps, reads_shapes = 10, False

    def control(self, actions: np.ndarray) -> np.ndarray:
        """Forces ``(..., 2)``: actions clipped to [-1, 1]; the gear turns 1 into 10 N."""
        return np.clip(np.asarray(actions, np.float64), -1.0, 1.0)

    def observe(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Observation (x, y, vx, vy) in m and m/s; achieved goal (x, y)."""
        return features.copy(), features[..., :2].copy()


class PointMazeEnv(OpenLoopEnv):
    """Goal-conditioned point maze.

    Action: force per axis in [-1, 1] ``(2,)``. Observation: (x, y, vx, vy). Goal: (x, y),
    reached within ``0.1 * scale`` metres. Reward: 0 when reached, else -1. One control step
    lasts 0.1 s. ``scale=4`` makes every length four times as long at the same speed.
    """

    camera = "top"
    step_length = 0.1  # metres per control step along one axis at full speed

    def __init__(self, scale: float = 1.0, render_mode: str | None = None) -> None:
        self.scale = scale
        self.model_spec = spec = _build_model(scale)
        super().__init__(PointMazeDynamics(spec.compile()), 0.1 * scale, render_mode)
        self._anywhere = False
        self._paths: ShortestPaths | None = None

    def shortest_steps(self, positions: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Steps ``(...)`` of the shortest way around the walls from positions ``(..., 2)``, at full speed."""
        if self._paths is None:
            from napsp.envs.geodesic import ShortestPaths  # SciPy's images and graphs: half a second to import

            margin = WALL_HALF_THICKNESS + POINT_RADIUS
            boxes = self.scale * np.array(INNER_WALLS + OUTER_WALLS) + [0.0, 0.0, margin, margin]
            self._paths = ShortestPaths(self.scale, boxes, self.step_length)
        return self._paths.steps(positions, goal)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        """As the task says; ``options={"anywhere": True}`` draws start and goal from all rooms alike."""
        self._anywhere = bool((options or {}).get("anywhere", False))
        return super().reset(seed=seed, options=options)

    def _start(self) -> None:
        """At rest in the lower left room; a goal in the upper right room."""
        mujoco.mj_resetData(self.model, self.data)
        if self._anywhere:
            signs = self.np_random.choice([-1.0, 1.0], (2, 2))
            start, self.goal = signs * self.np_random.uniform(0.12, 0.88, (2, 2)) * self.scale
            self.data.qpos[:] = start
            return
        self.data.qpos[:] = self.np_random.uniform(-0.8, -0.2, 2) * self.scale
        self.goal = self.np_random.uniform(0.2, 0.8, 2) * self.scale

    def goal_positions(self, goals: np.ndarray) -> np.ndarray:
        """Where goals ``(..., 2)`` lie in the world, ``(..., 3)``, for pictures."""
        return np.concatenate([goals, np.full((*goals.shape[:-1], 1), POINT_RADIUS)], axis=-1)
