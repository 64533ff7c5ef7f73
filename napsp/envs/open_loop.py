"""What tasks share whose control rows do not depend on the simulated state.

Their whole horizon is one ``mujoco.rollout`` call. A task adds a model, the mapping of
actions to controls and of (qpos, qvel) to observations, and how an episode starts.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import mujoco
import numpy as np
from gymnasium import spaces
from gymnasium_robotics.core import GoalEnv

from napsp.envs.dynamics import INTEGRATION_STATE


class OpenLoopSimulation:
    """A model on one ``MjData``: hold each control row for ``substeps`` physics steps."""

    def __init__(self, dynamics: OpenLoopDynamics, data: mujoco.MjData) -> None:
        self._model, self._data, self._substeps = dynamics.model, data, dynamics.substeps

    def advance(self, controls: np.ndarray, features: np.ndarray) -> None:
        """Apply controls ``(n, U)`` one after the other; write features ``(n, F)``."""
        for control, row in zip(controls, features, strict=True):
            self._data.ctrl[:] = control
            mujoco.mj_step(self._model, self._data, nstep=self._substeps)
            self.observe(row)

    def observe(self, features: np.ndarray) -> None:
        """Features ``(F,)``: qpos then qvel."""
        np.concatenate((self._data.qpos, self._data.qvel), out=features)

    def restore(self, state: np.ndarray) -> None:
        """Load a full integration state."""
        mujoco.mj_setState(self._model, self._data, state, INTEGRATION_STATE)


class OpenLoopDynamics(ABC):
    """Features are qpos then qvel; tasks add ``control`` and ``observe``."""

    open_loop = True
    substeps: int

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self.n_features = model.nq + model.nv

    def bind(self, data: mujoco.MjData) -> OpenLoopSimulation:
        """Simulate on ``data``."""
        return OpenLoopSimulation(self, data)

    @abstractmethod
    def control(self, actions: np.ndarray) -> np.ndarray:
        """Map actions ``(..., A)`` to control rows ``(..., U)``, float64."""

    @abstractmethod
    def observe(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Turn features ``(..., F)`` into observation ``(..., O)`` and achieved goal ``(..., G)``."""


class OpenLoopEnv(GoalEnv, ABC):
    """A goal task on open-loop dynamics. Reward: 0 within the threshold of the goal, else -1.

    Args:
        dynamics: the task's physics.
        distance_threshold: goals nearer than this, in units of the goal, count as reached.
        render_mode: ``rgb_array``, ``human`` or None.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 10}
    camera: str
    model_spec: mujoco.MjSpec | None = None
    """What the model was compiled from; with it, planners need not simulate what only pictures show, if the dynamics'
    class says ``reads_shapes = False``: they ask the model and its data for no shape, camera or light."""

    def __init__(self, dynamics: OpenLoopDynamics, distance_threshold: float, render_mode: str | None) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode {render_mode!r} is not one of {self.metadata['render_modes']}")
        self.dynamics, self.model = dynamics, dynamics.model
        self.data = mujoco.MjData(self.model)
        self.distance_threshold = distance_threshold
        self.render_mode = render_mode
        self._simulation = dynamics.bind(self.data)
        self._features = np.zeros((1, dynamics.n_features))
        self._renderer: Any = None
        observation, goal = dynamics.observe(self._features[0])
        self.goal = np.zeros_like(goal)
        unbounded = {"low": -np.inf, "high": np.inf, "dtype": np.float64}
        self.action_space = spaces.Box(-1.0, 1.0, (self.model.nu,), np.float32)
        self.observation_space = spaces.Dict(
            observation=spaces.Box(shape=observation.shape, **unbounded),
            achieved_goal=spaces.Box(shape=goal.shape, **unbounded),
            desired_goal=spaces.Box(shape=goal.shape, **unbounded),
        )

    @property
    def goal_radius(self) -> float:
        """Radius of the goal in the world, metres, for pictures."""
        return self.distance_threshold

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        """Start an episode with a new goal."""
        super().reset(seed=seed)
        self._start()
        mujoco.mj_forward(self.model, self.data)
        self._simulation.observe(self._features[0])
        if self.render_mode == "human":
            self.render()
        return self._observation(), {}

    @abstractmethod
    def _start(self) -> None:
        """Reset the data, place the system, draw ``goal``."""

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        """Advance one control step. Never terminates: reaching a goal is not an end."""
        self._simulation.advance(self.dynamics.control(action)[None], self._features)
        if self.render_mode == "human":
            self.render()
        observation = self._observation()
        reward = self.compute_reward(observation["achieved_goal"], self.goal, {})
        return observation, float(reward), False, False, {"is_success": bool(reward == 0)}

    def reached(self, achieved_goal: np.ndarray, desired_goal: np.ndarray) -> np.ndarray:
        """Tell for each pair of goals ``(..., G)`` whether they are within the threshold."""
        offset = np.asarray(achieved_goal) - np.asarray(desired_goal)
        return np.linalg.norm(offset, axis=-1) < self.distance_threshold

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

    @abstractmethod
    def goal_positions(self, goals: np.ndarray) -> np.ndarray:
        """Where goals ``(..., G)`` lie in the world, ``(..., 3)`` in metres, for pictures."""

    def _observation(self) -> dict[str, np.ndarray]:
        observation, achieved_goal = self.dynamics.observe(self._features[0].copy())  # it may return views
        return {"observation": observation, "achieved_goal": achieved_goal, "desired_goal": self.goal.copy()}

    def render(self) -> np.ndarray | None:
        """Draw the scene from the task's camera."""
        if self._renderer is None:
            from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer

            # camera_name is for off-screen frames only; a window opens with the free camera unless told.
            camera = {"type": mujoco.mjtCamera.mjCAMERA_FIXED, "fixedcamid": self.model.camera(self.camera).id}
            self._renderer = MujocoRenderer(self.model, self.data, camera, 480, 480, camera_name=self.camera)
        if self.render_mode == "human":  # the scene itself has no goal
            size, color = np.full(3, self.goal_radius), np.array([0.1, 0.75, 0.2, 0.4], np.float32)
            marker = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": size, "rgba": color, "label": "goal"}
            self._renderer._get_viewer("human").add_marker(pos=self.goal_positions(self.goal), **marker)
        return self._renderer.render(self.render_mode)

    def close(self) -> None:
        """Release the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
