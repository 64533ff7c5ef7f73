"""Families of stock environments of gymnasium-robotics, each seen through the same few members.

:class:`Robot` wraps a ``MujocoRobotEnv`` (Fetch, the shadow hand), :class:`Maze` a maze with an
agent in it (PointMaze, AntMaze). :mod:`napsp.envs.adapter` makes tasks of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np
from gymnasium import spaces
from gymnasium_robotics.envs.maze.maze import MazeEnv as OldMazeEnv
from gymnasium_robotics.envs.maze.maze_v4 import MazeEnv
from gymnasium_robotics.envs.robot_env import MujocoRobotEnv

MAZE_GOAL_RADIUS = 0.45  # written out in MazeEnv's own tests of success


class Stock(Protocol):
    """One stock environment: what its simulation, and the task around it, need to know.

    Attributes:
        env: the environment itself.
        observation_space: a dictionary space with Gymnasium's three keys.
        substeps: physics steps per control step.
        goal_radius: how close counts as being at the goal, for pictures and the straight-line cost.
        renders_steps: whether the environment's own step draws the scene for its viewer.
    """

    env: Any
    observation_space: spaces.Dict
    substeps: int
    goal_radius: float
    renders_steps: bool

    @property
    def model(self) -> mujoco.MjModel:
        """The model that is simulated."""
        ...

    @property
    def data(self) -> mujoco.MjData:
        """The state that is simulated."""
        ...

    @property
    def camera(self) -> dict[str, Any]:
        """A view of the whole scene, as attributes of ``mujoco.MjvCamera``."""
        ...

    def set_goal(self, goal: np.ndarray) -> None:
        """Ask for another desired goal ``(G,)``."""
        ...

    def use(self, model: mujoco.MjModel, data: mujoco.MjData, substeps: int) -> None:
        """Simulate ``data`` in ``model`` from now on."""
        ...

    def step(self, action: np.ndarray) -> None:
        """Advance by one control step; ``action`` is float32 ``(A,)``, within bounds."""
        ...

    def features(self) -> tuple[np.ndarray, np.ndarray]:
        """Observation ``(O,)`` and achieved goal ``(G,)`` of the current state."""
        ...

    def reached(self, achieved_goal: np.ndarray, desired_goal: np.ndarray) -> np.ndarray:
        """Whether the environment calls pairs of goals ``(..., G)`` a success, bool ``(...)``."""
        ...


class Robot:
    """A ``MujocoRobotEnv``; see :class:`Stock`."""

    renders_steps = False

    def __init__(self, env: MujocoRobotEnv) -> None:
        self.env: Any = env
        self.observation_space = self.env.observation_space
        self.substeps = self.env.n_substeps
        self.goal_radius = float(getattr(env, "distance_threshold", 0.05))

    @property
    def model(self) -> mujoco.MjModel:  # noqa: D102
        return self.env.model

    @property
    def data(self) -> mujoco.MjData:  # noqa: D102
        return self.env.data

    @property
    def camera(self) -> dict[str, Any]:  # noqa: D102
        return dict(self.env.mujoco_renderer.default_cam_config or {})

    def set_goal(self, goal: np.ndarray) -> None:  # noqa: D102
        self.env.goal = goal

    def use(self, model: mujoco.MjModel, data: mujoco.MjData, substeps: int) -> None:  # noqa: D102
        self.env.model, self.env.data, self.env.n_substeps = model, data, substeps

    def step(self, action: np.ndarray) -> None:  # noqa: D102
        self.env._set_action(action)
        self.env._mujoco_step(action)
        self.env._step_callback()

    def features(self) -> tuple[np.ndarray, np.ndarray]:  # noqa: D102
        values = self.env._get_obs()
        return values["observation"], values["achieved_goal"]

    def reached(self, achieved_goal: np.ndarray, desired_goal: np.ndarray) -> np.ndarray:  # noqa: D102
        # In rows: the rotations of HandManipulate take one or two axes, not more.
        pair = np.broadcast_arrays(achieved_goal, desired_goal)
        rows = [np.array(goals, np.float64).reshape(-1, goals.shape[-1]) for goals in pair]
        if getattr(self.env, "ignore_z_target_rotation", False):  # the pen's test mixes up rows if given several
            judged = [self.env._is_success(achieved, desired) for achieved, desired in zip(*rows, strict=True)]
        else:
            judged = self.env._is_success(*rows)
        return (np.asarray(judged) > 0).reshape(pair[0].shape[:-1])


class Maze:
    """A ``MazeEnv``; see :class:`Stock`.

    The observation is all that the agent has, its position included. Stock AntMaze leaves the
    position to ``achieved_goal``, but d(s, a, g) has to find it in s. The goal stays where it is for a
    whole episode. Contact forces, which AntMaze-v5 observes, are those of the last step: after another
    state was loaded they are right again one step later.

    Raises:
        TypeError: neither a point nor an ant is in it.
    """

    renders_steps = True

    def __init__(self, env: Any) -> None:
        self.env: Any = env
        agents = [agent for name in ("point_env", "ant_env") if (agent := getattr(env, name, None)) is not None]
        if not agents:
            raise TypeError(f"{type(env).__name__} has neither a point nor an ant in its maze")
        self._agent = agents[0]
        Path(env.tmp_xml_file_path).unlink(missing_ok=True)  # every stock maze leaves one behind
        self.substeps = self._agent.frame_skip
        self.goal_radius = MAZE_GOAL_RADIUS
        stock, agent = self.env.observation_space.spaces, self._agent.observation_space
        everything = spaces.Box(-np.inf, np.inf, agent.shape, np.float64)
        self.observation_space = spaces.Dict({**stock, "observation": everything})

    @property
    def model(self) -> mujoco.MjModel:  # noqa: D102
        return self._agent.model

    @property
    def data(self) -> mujoco.MjData:  # noqa: D102
        return self._agent.data

    @property
    def camera(self) -> dict[str, Any]:  # noqa: D102
        # The stock cameras see a part of a maze, and walls hide what stands behind them.
        extent = float(self.model.stat.extent)
        return {"lookat": self.model.stat.center, "distance": 1.2 * extent, "azimuth": 90.0, "elevation": -89.0}

    def set_goal(self, goal: np.ndarray) -> None:  # noqa: D102
        self.env.goal = goal
        self.env.update_target_site_pos()

    def use(self, model: mujoco.MjModel, data: mujoco.MjData, substeps: int) -> None:  # noqa: D102
        self._agent.model, self._agent.data, self._agent.frame_skip = model, data, substeps

    def step(self, action: np.ndarray) -> None:  # noqa: D102
        self._agent.step(action)

    def features(self) -> tuple[np.ndarray, np.ndarray]:  # noqa: D102
        values = self._agent._get_obs()
        observation = values[0] if isinstance(values, tuple) else values  # the point comes with an info dictionary
        return observation, observation[:2]

    def reached(self, achieved_goal: np.ndarray, desired_goal: np.ndarray) -> np.ndarray:  # noqa: D102
        return np.linalg.norm(np.asarray(achieved_goal) - desired_goal, axis=-1) <= self.goal_radius


FAMILIES: tuple[tuple[type, type[Robot] | type[Maze]], ...] = (
    (MujocoRobotEnv, Robot),
    (MazeEnv, Maze),
    (OldMazeEnv, Maze),
)


def wrap(env: Any) -> Stock:
    """See a stock environment as its family.

    Raises:
        TypeError: it belongs to none.
    """
    for kind, family in FAMILIES:
        if isinstance(env, kind):
            return family(env)
    raise TypeError(f"{type(env).__name__} is neither a MujocoRobotEnv nor a MazeEnv of gymnasium-robotics")
