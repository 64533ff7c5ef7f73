"""Fetch reaching tasks, with and without a wall (paper, section 6 "3D reaching task").

See :mod:`napsp.envs.fetch_arm` for what differs from gymnasium-robotics' FetchReach.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import mujoco
import numpy as np
from gymnasium_robotics.envs.fetch.reach import MujocoFetchReachEnv

from napsp.envs.fetch_arm import GRIPPER_ROTATION, FetchDynamics, FetchSimulation, ThinFetch, Walled


class FetchReachSimulation(FetchSimulation):
    """The arm with blocked fingers on one ``MjData``."""

    def advance(self, controls: np.ndarray, features: np.ndarray) -> None:
        """Run control steps ``(n, 3)``, writing features ``(n, F)``.

        Each re-anchors the mocap to the gripper, displaces it, advances the physics and closes
        the fingers (Fetch reaching blocks the gripper by setting its joints back). Stock Fetch
        ends with mj_forward; kinematics give the same poses to the bit.
        """
        # Calls are bound and rows are cut outside the loop: between physics steps caches are
        # cold, and what Python looks up, allocates or shares between threads costs most.
        target = self._target
        displace = partial(np.add, self._anchor)
        rotate = partial(np.add, self._rotation, GRIPPER_ROTATION.copy(), self._target_rotation)
        step = partial(mujoco.mj_step, self._model, self._data, self._substeps)
        close_fingers = partial(self._fingers.fill, 0.0)
        update_poses = partial(mujoco.mj_kinematics, self._model, self._data)
        record = partial(np.concatenate, self._recorded, 0)
        for control, row in zip(list(controls), list(features), strict=True):
            displace(control, target)
            rotate()
            step()
            close_fingers()
            update_poses()
            record(row)


class FetchReachDynamics(FetchDynamics):
    """Mocap control of the gripper with blocked fingers; a control row is a displacement ``(3,)``."""

    reads_shapes = False

    def bind(self, data: mujoco.MjData) -> FetchReachSimulation:
        """Simulate on ``data``."""
        return FetchReachSimulation(self, data)

    def observe(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fetch's observation ``(..., 10)`` and the grip position ``(..., 3)``.

        Order: grip position [m], finger positions [m], grip velocity and finger velocities
        [m per control step].
        """
        observation = np.empty((*features.shape[:-1], 10))
        observation[..., 0:5] = features[..., 0:5]
        self._grip_velocity(features, observation[..., 5:8])
        observation[..., 8:10] = features[..., 5 + self.fingers.start : 5 + self.fingers.stop] * self._dt
        return observation, features[..., 0:3].copy()


class FetchReachEnv(ThinFetch, MujocoFetchReachEnv):
    """FetchReach with a thin step and, unless ``arm_self_collision``, a filtered arm."""

    def _make_dynamics(self, model: mujoco.MjModel) -> FetchReachDynamics:
        return FetchReachDynamics(model)


class FetchReachWallEnv(Walled, FetchReachEnv):
    """Start on one half of the table, goal on the other half, a wall between (paper, section 6)."""

    GOAL_LOW = np.array([1.20, 0.85, 0.42])  # "on the ground": at most 2 cm above the lowest
    GOAL_HIGH = np.array([1.48, 1.00, 0.44])  # grip height the fingers allow (0.4185)

    def __init__(self, wall_height: float = 0.20, **kwargs: Any) -> None:
        super().__init__(wall_height, **kwargs)

    def _sample_goal(self) -> np.ndarray:
        return self.np_random.uniform(self.GOAL_LOW, self.GOAL_HIGH)
