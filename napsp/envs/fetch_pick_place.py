"""Fetch pick and place, with and without a wall (paper, section 6 "3D manipulation task").

See :mod:`napsp.envs.fetch_arm` for what differs from gymnasium-robotics' FetchPickAndPlace.
Stock leaves body poses one physics step stale, anchors the next step to them and freshens
them when it renders; here every step ends with fresh poses, so that what follows depends on
the integration state alone.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import mujoco
import numpy as np
from gymnasium_robotics.envs.fetch.pick_and_place import MujocoFetchPickAndPlaceEnv

from napsp.envs.fetch_arm import GRIPPER_ROTATION, FetchDynamics, FetchSimulation, ThinFetch, Walled
from napsp.envs.grasp import grasp

BESIDE = 0.1  # metres in the plane from the gripper to where stock Fetch puts the box, at least
SINGULAR = np.finfo(np.float64).eps * 4.0  # below this cosine of the pitch, Euler angles degenerate


class FetchPickPlaceSimulation(FetchSimulation):
    """The arm, its fingers and a box on one ``MjData``."""

    def __init__(self, dynamics: FetchPickPlaceDynamics, data: mujoco.MjData) -> None:
        super().__init__(dynamics, data)
        box = dynamics.model.site("object0").id
        self._recorded = (*self._recorded, data.site_xpos[box], data.site_xmat[box])
        self._actuated = self._fingers[::-1]  # actuators are ordered left, right; joints right, left
        self._finger_targets = data.ctrl

    def advance(self, controls: np.ndarray, features: np.ndarray) -> None:
        """Run control steps ``(n, 4)``, writing features ``(n, F)``.

        Each re-anchors the mocap to the gripper, displaces it, sets the fingers' targets
        relative to where they are, and advances the physics.
        """
        # Bound and cut outside the loop, as in reaching.
        target, finger_targets = self._target, self._finger_targets
        displace = partial(np.add, self._anchor)
        rotate = partial(np.add, self._rotation, GRIPPER_ROTATION.copy(), self._target_rotation)
        squeeze = partial(np.add, self._actuated)
        step = partial(mujoco.mj_step, self._model, self._data, self._substeps)
        update_poses = partial(mujoco.mj_kinematics, self._model, self._data)
        record = partial(np.concatenate, self._recorded, 0)
        rows = zip(list(controls[:, :3]), list(controls[:, 3:]), list(features), strict=True)
        for displacement, opening, row in rows:
            displace(displacement, target)
            rotate()
            squeeze(opening, finger_targets)
            step()
            update_poses()
            record(row)


class FetchPickPlaceDynamics(FetchDynamics):
    """Mocap control of the gripper and position control of the fingers.

    A control row is the displacement of the mocap anchor (3) and of both fingers' targets
    (1), in metres. Features: those of :class:`FetchDynamics`, box position (3) and rotation
    matrix (9).

    Args:
        model: Fetch with a free box ``object0``.
        augmented_goal: whether the achieved goal is box and grip position ``(6,)`` or the
            box position ``(3,)``.
    """

    n_controls, reads_shapes = 4, False

    def __init__(self, model: mujoco.MjModel, augmented_goal: bool) -> None:
        super().__init__(model)
        right, left = range(self.fingers.start, self.fingers.stop)
        site = model.site("object0")
        if int(model.joint("object0:joint").dofadr[0]) != self.n_joints or site.pos.any() or site.quat[0] != 1.0:
            raise ValueError("the Fetch model has changed: expected the box after the arm, its site in its centre")
        if model.actuator_trnid[:, 0].tolist() != [left, right]:
            raise ValueError("the Fetch model has changed: expected actuators for the left, then the right finger")
        self._augmented = augmented_goal
        self._box = self.n_features
        self.n_features += 12

    def bind(self, data: mujoco.MjData) -> FetchPickPlaceSimulation:
        """Simulate on ``data``."""
        return FetchPickPlaceSimulation(self, data)

    def control(self, actions: np.ndarray) -> np.ndarray:
        """Displacements ``(..., 4)`` in metres; the fingers' one is not scaled, as in Fetch."""
        actions = np.asarray(actions, np.float32)
        controls = np.empty(actions.shape)
        controls[..., :3] = super().control(actions)
        controls[..., 3] = np.clip(actions[..., 3], -1.0, 1.0)
        return controls

    def observe(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fetch's observation ``(..., 25)`` and the achieved goal, ``(..., 6)`` or ``(..., 3)``.

        Order, velocities per control step: grip position [m], box position [m] and relative
        to the grip [m], finger positions [m], box rotation (Euler) [rad], box velocity relative
        to the grip [m], box rotational velocity [rad], grip velocity [m], finger velocities [m].
        """
        grip, fingers = features[..., 0:3], self.fingers
        speeds = features[..., 5 : 5 + self.model.nv] * self._dt
        position, rotation = features[..., self._box : self._box + 3], features[..., self._box + 3 : self._box + 12]
        linear, angular = speeds[..., self.n_joints : self.n_joints + 3], speeds[..., self.n_joints + 3 :]
        observation = np.empty((*features.shape[:-1], 25))
        observation[..., 0:3] = grip
        observation[..., 3:6] = position
        observation[..., 6:9] = position - grip
        observation[..., 9:11] = features[..., 3:5]
        _euler_angles(rotation, observation[..., 11:14])
        self._grip_velocity(features, observation[..., 20:23])
        observation[..., 14:17] = linear - observation[..., 20:23]
        for i in range(3):  # a free joint's angular velocity is in the box's own frame
            row = rotation[..., 3 * i : 3 * i + 3]
            observation[..., 17 + i] = (
                row[..., 0] * angular[..., 0] + row[..., 1] * angular[..., 1] + row[..., 2] * angular[..., 2]
            )
        observation[..., 23:25] = speeds[..., fingers]
        achieved = np.concatenate([position, grip], axis=-1) if self._augmented else position.copy()
        return observation, achieved


def _euler_angles(matrix: np.ndarray, out: np.ndarray) -> None:
    """Write Euler angles ``(..., 3)`` of row-major matrices ``(..., 9)``, as gymnasium-robotics' ``mat2euler``."""
    m = [np.ascontiguousarray(matrix[..., i]) for i in range(9)]
    cosine = np.sqrt(m[8] * m[8] + m[5] * m[5])
    regular = cosine > SINGULAR
    out[..., 0] = np.where(regular, -np.arctan2(m[5], m[8]), 0.0)
    out[..., 1] = -np.arctan2(-m[2], cosine)
    out[..., 2] = np.where(regular, -np.arctan2(m[1], m[0]), -np.arctan2(-m[3], m[4]))


class FetchPickPlaceEnv(ThinFetch, MujocoFetchPickAndPlaceEnv):
    """Bring the box to a goal on the table or, with chance one half, in the air.

    The goal is augmented (paper, section 6.1): box *and* gripper at the target. Achieved goals
    are box and grip position, desired goals the target twice. With ``augmented_goal=False``
    goals are box positions, as in stock Fetch.
    """

    grasps = True

    def __init__(self, augmented_goal: bool = True, **kwargs: Any) -> None:
        self.augmented_goal = augmented_goal
        super().__init__(**kwargs)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict]:
        """Begin an episode; with ``options={"box_held": True}`` the gripper has the box already."""
        observation, info = super().reset(seed=seed, options=options)
        if (options or {}).get("box_held"):
            grasp(observation["observation"], self._act)
            observation = self._get_obs()
        return observation, info

    def _act(self, action: np.ndarray) -> np.ndarray:
        self._advance(self.dynamics.control(action))
        return self._observation()["observation"]

    def _reset_sim(self) -> bool:
        mujoco.mj_resetData(self.model, self.data)
        self.data.time, self.data.qpos, self.data.qvel = self.initial_time, self.initial_qpos, self.initial_qvel
        grip = box = self.initial_gripper_xpos[:2]
        while np.linalg.norm(box - grip) < BESIDE:
            box = grip + self.np_random.uniform(-self.obj_range, self.obj_range, size=2)
        self.data.joint("object0:joint").qpos[:2] = box
        mujoco.mj_forward(self.model, self.data)
        return True

    def _make_dynamics(self, model: mujoco.MjModel) -> FetchPickPlaceDynamics:
        return FetchPickPlaceDynamics(model, self.augmented_goal)

    def _sample_goal(self) -> np.ndarray:
        return np.tile(self._sample_box_goal(), 2 if self.augmented_goal else 1)

    def _sample_box_goal(self) -> np.ndarray:
        return super()._sample_goal()

    def reached(self, achieved_goal: np.ndarray, desired_goal: np.ndarray) -> np.ndarray:
        """Tell for each pair of goals ``(..., 6)`` whether box and gripper both are within 5 cm.

        Goals ``(..., 3)`` compare the box alone: stock Fetch's success.
        """
        offset = np.asarray(achieved_goal) - np.asarray(desired_goal)
        parts = offset.reshape(*offset.shape[:-1], -1, 3)
        return (np.linalg.norm(parts, axis=-1) < self.distance_threshold).all(-1)

    def compute_reward(self, achieved_goal: np.ndarray, goal: np.ndarray, info: Any) -> Any:
        """Sparse reward ``(...)``: 0 where reached, -1 elsewhere; dense if the task was made so."""
        if self.reward_type != "sparse":
            return super().compute_reward(achieved_goal, goal, info)
        return self.reached(achieved_goal, goal).astype(np.float32) - np.float32(1)

    def goal_positions(self, goals: np.ndarray) -> np.ndarray:
        """Where the box is to go for goals ``(..., 6)`` or ``(..., 3)``, for pictures."""
        return goals[..., :3]

    def _render_callback(self) -> None:
        target = self.model.site("target0")  # on a body that stands still without rotation
        target.pos = self.goal_positions(self.goal) - self.model.body_pos[target.bodyid[0]]
        mujoco.mj_forward(self.model, self.data)


class FetchPickPlaceWallEnv(Walled, FetchPickPlaceEnv):
    """Box on one half of the table, goal on or above the other half, a wall between (paper, section 6)."""

    BOX_LOW, BOX_HIGH = np.array([1.22, 0.52]), np.array([1.44, 0.64])
    CLEARANCE = 0.05  # metres from gripper to box at the start, in the plane
    GOAL_LOW, GOAL_HIGH = np.array([1.22, 0.86]), np.array([1.44, 0.98])
    MAX_HEIGHT = 0.45  # metres above the table's goals, as in Fetch

    def __init__(self, wall_height: float = 0.15, **kwargs: Any) -> None:
        super().__init__(wall_height, **kwargs)

    def _reset_sim(self) -> bool:
        super()._reset_sim()
        grip = box = self.initial_gripper_xpos[:2]
        while np.linalg.norm(box - grip) < self.CLEARANCE:
            box = self.np_random.uniform(self.BOX_LOW, self.BOX_HIGH)
        start = int(self.model.joint("object0:joint").qposadr[0])
        self.data.qpos[start : start + 2] = box
        mujoco.mj_forward(self.model, self.data)
        return True

    def _sample_box_goal(self) -> np.ndarray:
        goal = np.append(self.np_random.uniform(self.GOAL_LOW, self.GOAL_HIGH), self.height_offset)
        if self.np_random.uniform() < 0.5:
            goal[2] += self.np_random.uniform(0.0, self.MAX_HEIGHT)
        return goal
