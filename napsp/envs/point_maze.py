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

from typing import Any

import mujoco
import numpy as np
from gymnasium import spaces
from gymnasium_robotics.core import GoalEnv

from napsp.envs.dynamics import INTEGRATION_STATE

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


def _build_model(scale: float) -> mujoco.MjModel:
    walls = "\n".join(
        f'<geom type="box" pos="{x * scale} {y * scale} 0.08" rgba="0.35 0.38 0.45 1" '
        f'size="{hx * scale + WALL_HALF_THICKNESS} {hy * scale + WALL_HALF_THICKNESS} 0.08"/>'
        for x, y, hx, hy in INNER_WALLS + OUTER_WALLS
    )
    # Mass 1 kg, damping 10, gear 10: top speed 1 m/s per axis, time constant 0.1 s (one
    # control step). Damping takes the place of a velocity clip, so that nothing happens
    # between two physics steps and a whole horizon is one open-loop rollout.
    return mujoco.MjModel.from_xml_string(f"""
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


class PointMazeSimulation:
    """The point on one ``MjData``: hold a force for ``substeps`` physics steps."""

    def __init__(self, dynamics: PointMazeDynamics, data: mujoco.MjData) -> None:
        self._model, self._data, self._substeps = dynamics.model, data, dynamics.substeps

    def advance(self, controls: np.ndarray, features: np.ndarray) -> None:
        """Apply forces ``(n, 2)`` one after the other; write features ``(n, 4)``."""
        for control, row in zip(controls, features, strict=True):
            self._data.ctrl[:] = control
            mujoco.mj_step(self._model, self._data, nstep=self._substeps)
            self.observe(row)

    def observe(self, features: np.ndarray) -> None:
        """Features ``(4,)``: qpos then qvel."""
        features[:2] = self._data.qpos
        features[2:] = self._data.qvel

    def restore(self, state: np.ndarray) -> None:
        """Load a full integration state."""
        mujoco.mj_setState(self._model, self._data, state, INTEGRATION_STATE)


class PointMazeDynamics:
    """Force control of the point: a control row is the action, features are (x, y, vx, vy)."""

    open_loop = True
    substeps = 10
    n_features = 4

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model

    def bind(self, data: mujoco.MjData) -> PointMazeSimulation:
        """Simulate on ``data``."""
        return PointMazeSimulation(self, data)

    def control(self, actions: np.ndarray) -> np.ndarray:
        """Forces ``(..., 2)``: actions clipped to [-1, 1]; the gear turns 1 into 10 N."""
        return np.clip(np.asarray(actions, np.float64), -1.0, 1.0)

    def observe(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Observation (x, y, vx, vy) in m and m/s; achieved goal (x, y)."""
        return features.copy(), features[..., :2].copy()


class PointMazeEnv(GoalEnv):
    """Goal-conditioned point maze.

    Action: force per axis in [-1, 1] ``(2,)``. Observation: (x, y, vx, vy). Goal: (x, y),
    reached within ``0.1 * scale`` metres. Reward: 0 when reached, else -1. One control step
    lasts 0.1 s. ``scale=4`` makes every length four times as long at the same speed.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 10}

    def __init__(self, scale: float = 1.0, render_mode: str | None = None) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode {render_mode!r} is not one of {self.metadata['render_modes']}")
        self.scale = scale
        self.distance_threshold = 0.1 * scale
        self.step_length = 0.1  # metres per control step along one axis at full speed
        self.model = _build_model(scale)
        self.data = mujoco.MjData(self.model)
        self.dynamics = PointMazeDynamics(self.model)
        self._simulation = self.dynamics.bind(self.data)
        self.render_mode = render_mode
        self.goal = np.zeros(2)
        self._features = np.zeros((1, self.dynamics.n_features))
        self._renderer: Any = None
        unbounded = {"low": -np.inf, "high": np.inf, "dtype": np.float64}
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = spaces.Dict(
            observation=spaces.Box(shape=(4,), **unbounded),
            achieved_goal=spaces.Box(shape=(2,), **unbounded),
            desired_goal=spaces.Box(shape=(2,), **unbounded),
        )

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        """Start at rest in the lower left room; draw a goal in the upper right room."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self.np_random.uniform(-0.8, -0.2, 2) * self.scale
        self.goal = self.np_random.uniform(0.2, 0.8, 2) * self.scale
        mujoco.mj_forward(self.model, self.data)
        self._simulation.observe(self._features[0])
        return self._observation(), {}

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        """Advance one control step (0.1 s). Never terminates: reaching a goal is not an end."""
        self._simulation.advance(self.dynamics.control(action)[None], self._features)
        observation = self._observation()
        reward = self.compute_reward(observation["achieved_goal"], self.goal, {})
        return observation, float(reward), False, False, {"is_success": bool(reward == 0)}

    def reached(self, achieved_goal: np.ndarray, desired_goal: np.ndarray) -> np.ndarray:
        """Tell for each pair of goals ``(..., 2)`` whether they are within the threshold."""
        offset = np.asarray(achieved_goal) - np.asarray(desired_goal)
        return np.linalg.norm(offset, axis=-1) < self.distance_threshold

    def goal_positions(self, goals: np.ndarray) -> np.ndarray:
        """Where goals ``(..., 2)`` lie in the world, ``(..., 3)``, for pictures."""
        return np.concatenate([goals, np.full((*goals.shape[:-1], 1), POINT_RADIUS)], axis=-1)

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> Any:
        """Sparse reward ``(...)``: 0 where reached, -1 elsewhere."""
        del info
        return self.reached(achieved_goal, desired_goal).astype(np.float32) - np.float32(1)

    def compute_terminated(self, achieved_goal: Any, desired_goal: Any, info: Any) -> bool:
        """Goal reaching continues after success, so there is no termination."""
        return False

    def compute_truncated(self, achieved_goal: Any, desired_goal: Any, info: Any) -> bool:
        """The time limit is a wrapper's business."""
        return False

    def _observation(self) -> dict[str, np.ndarray]:
        observation, achieved_goal = self.dynamics.observe(self._features[0])
        return {"observation": observation, "achieved_goal": achieved_goal, "desired_goal": self.goal.copy()}

    def render(self) -> np.ndarray | None:
        """Draw the maze from above."""
        if self._renderer is None:
            from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer

            self._renderer = MujocoRenderer(self.model, self.data, width=480, height=480, camera_name="top")
        return self._renderer.render(self.render_mode)

    def close(self) -> None:
        """Release the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
