"""Any stock robot or maze of gymnasium-robotics as a task that can be planned in.

Slower than the tasks of this package - the environment's own Python runs inside every rollout -
and equally exact: environment and rollouts call the same functions. As in every task here, the reward
is 0 or -1, the goal stays for a whole episode, which only its length ends, and actions lie in [-1, 1]: the
stock environment's whole box, whatever its bounds. In the physics one thing
differs from the stock environment: every step ends with fresh body poses. Stock ones may be a physics
step old, and the next step of Fetch starts from them, so what follows would not depend on MuJoCo's state
alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import flatdim

from napsp.envs.dynamics import INTEGRATION_STATE
from napsp.envs.stock import Stock, wrap
from napsp.errors import UserError


class StockSimulation:
    """A stock environment's control step on one ``MjData``."""

    def __init__(self, stock: Stock) -> None:
        self._stock, self._model, self._data = stock, stock.model, stock.data

    def advance(self, controls: np.ndarray, features: np.ndarray) -> None:
        """Apply actions ``(n, A)`` one after the other; write features ``(n, O + G)``."""
        for control, row in zip(controls.astype(np.float32), features, strict=True):
            self._stock.step(control)
            self.refresh()
            self.observe(row)

    def observe(self, features: np.ndarray) -> None:
        """Features ``(O + G,)``: observation, then achieved goal."""
        observation, achieved_goal = self._stock.features()
        np.concatenate((observation.ravel(), achieved_goal.ravel()), out=features)

    def restore(self, state: np.ndarray) -> None:
        """Load a full integration state."""
        mujoco.mj_setState(self._model, self._data, state, INTEGRATION_STATE)
        self.refresh()

    def refresh(self) -> None:
        """Bring body poses up to date."""
        # Not mj_forward: it would solve the constraints and move the next step's warm start.
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)


class StockDynamics:
    """A control row is the action; features are observation and achieved goal.

    Args:
        stock: the environment whose model is planned with.
        make: makes another one; every simulation needs its own.

    Raises:
        UserError: the environment's actions have no bounds.
    """

    open_loop = False

    def __init__(self, stock: Stock, make: Callable[[], Stock]) -> None:
        self.model, self.substeps = stock.model, stock.substeps
        spaces = stock.observation_space.spaces
        self._n_observation = flatdim(spaces["observation"])
        self.n_features = self._n_observation + flatdim(spaces["achieved_goal"])
        low, high = stock.env.action_space.low, stock.env.action_space.high
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            raise UserError(
                f"the actions of {type(stock.env).__name__} have no bounds; give its action_space finite ones"
            )
        self._box = low.astype(np.float64), high.astype(np.float64)
        self._scaled = bool((low != -1.0).any() or (high != 1.0).any())
        self._make = make

    def bind(self, data: mujoco.MjData) -> StockSimulation:
        """Simulate on ``data``."""
        stock = self._make()
        stock.use(self.model, data, self.substeps)
        return StockSimulation(stock)

    def control(self, actions: np.ndarray) -> np.ndarray:
        """Actions ``(..., A)`` clipped to [-1, 1], as stock actions in its box, in float32 numbers as its steps use."""
        clipped = np.clip(np.asarray(actions, np.float32), -1.0, 1.0).astype(np.float64)
        if not self._scaled:
            return clipped
        low, high = self._box
        return np.clip(low + 0.5 * (clipped + 1.0) * (high - low), low, high).astype(np.float32).astype(np.float64)

    def observe(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Observation ``(..., O)`` and achieved goal ``(..., G)``."""
        return features[..., : self._n_observation].copy(), features[..., self._n_observation :].copy()


class StockTask(gymnasium.Env):
    """A stock environment with the interface of this package's tasks; reward 0 on success, else -1.

    Args:
        make: makes the environment.
        render_mode: Gymnasium's.

    Raises:
        TypeError: the environment is neither a ``MujocoRobotEnv`` nor a ``MazeEnv``.
        UserError: its actions have no bounds.
    """

    task_name: str | None = None
    """What the user calls it, if it was made by a name."""

    def __init__(self, make: Callable[..., Any], render_mode: str | None = None) -> None:
        self._stock = wrap(make(render_mode=render_mode))
        env = self._stock.env
        self.metadata, self.render_mode = env.metadata, render_mode
        self.observation_space = self._stock.observation_space
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, env.action_space.shape, np.float32)
        self.model, self.data = self._stock.model, self._stock.data
        self.dynamics = StockDynamics(self._stock, lambda: wrap(make()))
        self._simulation = StockSimulation(self._stock)
        self._features = np.zeros((1, self.dynamics.n_features))
        self.goal_radius = self._stock.goal_radius
        self.step_length = self.goal_radius  # unknown; for the Euclidean cost one goal radius per step

    @property
    def goal(self) -> np.ndarray:
        """The desired goal ``(G,)``."""
        return self._stock.env.goal

    @goal.setter
    def goal(self, goal: np.ndarray) -> None:
        self._stock.set_goal(goal)

    @property
    def camera(self) -> mujoco.MjvCamera:
        """Where videos are taken from."""
        camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(self.model, camera)
        for name, value in self._stock.camera.items():
            if name == "lookat":
                camera.lookat[:] = value
            else:
                setattr(camera, name, value)
        return camera

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        """Start an episode as the stock environment does."""
        super().reset(seed=seed)
        self._stock.env.reset(seed=seed, options=options)
        self._simulation.refresh()
        self._simulation.observe(self._features[0])
        return self._observation(), {}

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        """Advance one control step; never terminates."""
        self._simulation.advance(self.dynamics.control(action)[None], self._features)
        if self.render_mode == "human" and not self._stock.renders_steps:
            self.render()
        observation = self._observation()
        success = bool(self.reached(observation["achieved_goal"], self.goal))
        return observation, float(success) - 1.0, False, False, {"is_success": success}

    def reached(self, achieved_goal: np.ndarray, desired_goal: np.ndarray) -> np.ndarray:
        """Tell for each pair of goals ``(..., G)`` whether the stock environment calls it a success."""
        return self._stock.reached(achieved_goal, desired_goal)

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
        return self._stock.env.render()

    def close(self) -> None:
        """Release the renderer."""
        self._stock.env.close()

    def _observation(self) -> dict[str, np.ndarray]:
        observation, achieved_goal = self.dynamics.observe(self._features[0].copy())
        return {"observation": observation, "achieved_goal": achieved_goal, "desired_goal": self.goal.copy()}
