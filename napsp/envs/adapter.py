"""Any Gymnasium-Robotics ``MujocoRobotEnv`` as a task that can be planned in.

Slower than the tasks of this package - the environment's own Python runs inside every rollout -
and equally exact: environment and rollouts call the same functions. One thing differs from the
stock environment: every step ends with fresh body poses. Stock ones may be a physics step old,
and the next step of Fetch starts from them, so what follows would not depend on MuJoCo's state alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium_robotics.envs.robot_env import MujocoRobotEnv

from napsp.envs.dynamics import INTEGRATION_STATE


class RobotSimulation:
    """A stock environment's control step on one ``MjData``."""

    def __init__(self, robot: Any) -> None:
        self._robot, self._model, self._data = robot, robot.model, robot.data

    def advance(self, controls: np.ndarray, features: np.ndarray) -> None:
        """Apply actions ``(n, A)`` one after the other; write features ``(n, O + G)``."""
        robot = self._robot
        for control, row in zip(controls.astype(np.float32), features, strict=True):
            robot._set_action(control)
            robot._mujoco_step(control)
            robot._step_callback()
            self._refresh()
            self.observe(row)

    def observe(self, features: np.ndarray) -> None:
        """Features ``(O + G,)``: observation, then achieved goal."""
        values = self._robot._get_obs()
        np.concatenate((values["observation"].ravel(), values["achieved_goal"].ravel()), out=features)

    def restore(self, state: np.ndarray) -> None:
        """Load a full integration state."""
        mujoco.mj_setState(self._model, self._data, state, INTEGRATION_STATE)
        self._refresh()

    def _refresh(self) -> None:
        # Not mj_forward: it would solve the constraints and move the next step's warm start.
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)


class RobotDynamics:
    """A control row is the action; features are observation and achieved goal.

    Args:
        robot: the environment whose model is planned with.
        make_robot: makes another one; every simulation needs its own.
    """

    open_loop = False

    def __init__(self, robot: Any, make_robot: Callable[[], Any]) -> None:
        self.model, self.substeps = robot.model, robot.n_substeps
        spaces = robot.observation_space.spaces
        self._n_observation = int(np.prod(spaces["observation"].shape))
        self.n_features = self._n_observation + int(np.prod(spaces["achieved_goal"].shape))
        self._low, self._high = robot.action_space.low, robot.action_space.high
        self._make_robot = make_robot

    def bind(self, data: mujoco.MjData) -> RobotSimulation:
        """Simulate on ``data``."""
        robot = self._make_robot()
        robot.model, robot.data, robot.n_substeps = self.model, data, self.substeps
        return RobotSimulation(robot)

    def control(self, actions: np.ndarray) -> np.ndarray:
        """Actions ``(..., A)`` clipped to the action space, in float32 numbers as stock steps use them."""
        return np.clip(np.asarray(actions, np.float32), self._low, self._high).astype(np.float64)

    def observe(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Observation ``(..., O)`` and achieved goal ``(..., G)``."""
        return features[..., : self._n_observation].copy(), features[..., self._n_observation :].copy()


class RobotTask(gymnasium.Env):
    """A ``MujocoRobotEnv`` with the interface of this package's tasks; reward 0 on success, else -1."""

    def __init__(self, make_robot: Callable[..., Any], render_mode: str | None = None) -> None:
        self._robot = make_robot(render_mode=render_mode)
        if not isinstance(self._robot, MujocoRobotEnv):
            raise TypeError(f"{type(self._robot).__name__} is not a MujocoRobotEnv of gymnasium-robotics")
        self.metadata, self.render_mode = self._robot.metadata, render_mode
        self.observation_space, self.action_space = self._robot.observation_space, self._robot.action_space
        self.model, self.data = self._robot.model, self._robot.data
        self.dynamics = RobotDynamics(self._robot, make_robot)
        self._simulation = RobotSimulation(self._robot)
        self._features = np.zeros((1, self.dynamics.n_features))
        self.goal_radius = float(getattr(self._robot, "distance_threshold", 0.05))
        self.step_length = self.goal_radius  # unknown; for the Euclidean cost one goal radius per step

    @property
    def goal(self) -> np.ndarray:
        """The desired goal ``(G,)``."""
        return self._robot.goal

    @goal.setter
    def goal(self, goal: np.ndarray) -> None:
        self._robot.goal = goal

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        """Start an episode as the stock environment does."""
        super().reset(seed=seed)
        self._robot.reset(seed=seed, options=options)
        self._simulation._refresh()
        self._simulation.observe(self._features[0])
        return self._observation(), {}

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        """Advance one control step; never terminates."""
        self._simulation.advance(self.dynamics.control(action)[None], self._features)
        if self.render_mode == "human":
            self.render()
        observation = self._observation()
        success = bool(self.reached(observation["achieved_goal"], self.goal))
        return observation, float(success) - 1.0, False, False, {"is_success": success}

    def reached(self, achieved_goal: np.ndarray, desired_goal: np.ndarray) -> np.ndarray:
        """Tell for each pair of goals ``(..., G)`` whether the stock environment calls it a success."""
        return np.asarray(self._robot._is_success(np.asarray(achieved_goal), np.asarray(desired_goal))) > 0

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Any) -> Any:
        """Sparse reward ``(...)``: 0 where reached, -1 elsewhere."""
        del info
        return self.reached(achieved_goal, desired_goal).astype(np.float32) - np.float32(1)

    def goal_positions(self, goals: np.ndarray) -> np.ndarray:
        """First three coordinates of goals ``(..., G)``, padded with zeros, for pictures."""
        missing = max(0, 3 - goals.shape[-1])
        return np.pad(goals[..., :3], [(0, 0)] * (goals.ndim - 1) + [(0, missing)])

    def render(self) -> Any:
        """Draw the scene; the physics does not notice."""
        return self._robot.render()

    def close(self) -> None:
        """Release the renderer."""
        self._robot.close()

    def _observation(self) -> dict[str, np.ndarray]:
        observation, achieved_goal = self.dynamics.observe(self._features[0])
        return {"observation": observation, "achieved_goal": achieved_goal, "desired_goal": self.goal.copy()}
