"""What all Fetch tasks share: mocap control, the grip's velocity, one thin step, and the wall.

Built on gymnasium-robotics' v4 Fetch classes: same robot, actions and observation. What is
ours: collision filtering of the arm *in the model itself*, a wall, and one control step as
functions of ``(model, data)`` that environment and planner share.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import mujoco
import numpy as np

from napsp.envs.dynamics import INTEGRATION_STATE, Dynamics

ACTION_SCALE = np.float32(0.05)  # metres of mocap displacement per unit action, as in Fetch
# Fetch adds this quaternion to the gripper's own one; MuJoCo normalises the sum.
GRIPPER_ROTATION = np.array([1.0, 0.0, 1.0, 0.0])
GRIPPER_BODIES = ("robot0:gripper_link", "robot0:r_gripper_finger_link", "robot0:l_gripper_finger_link")
LOWER_ARM_BODIES = tuple(
    f"robot0:{link}_link" for link in ("upperarm_roll", "elbow_flex", "forearm_roll", "wrist_flex", "wrist_roll")
)
BASE_BODIES = tuple(f"robot0:{link}_link" for link in ("base", "torso_lift", "torso_fixed", "laser", "estop"))
# Collision bits besides MuJoCo's default 1, which gripper, fingers, table, wall and box share.
ARM_BIT = 2  # lower arm: meets table, wall and box
BASE_BIT = 4  # base and torso: meet the gripper
REST = ("table0", "object0")  # with the wall, what the lower arm meets


class FetchSimulation:
    """The arm on one ``MjData``; subclasses advance it."""

    def __init__(self, dynamics: FetchDynamics, data: mujoco.MjData) -> None:
        model, joints = dynamics.model, slice(dynamics.n_joints)
        self._model, self._data, self._substeps = model, data, dynamics.substeps
        gripper, site = model.body("robot0:gripper_link").id, model.site("robot0:grip").id
        self._anchor, self._rotation = data.xpos[gripper], data.xquat[gripper]
        self._target, self._target_rotation = data.mocap_pos[0], data.mocap_quat[0]
        self._fingers = data.qpos[dynamics.fingers]
        frames = data.xaxis[joints].reshape(-1), data.xanchor[joints].reshape(-1)
        self._recorded = (data.site_xpos[site], self._fingers, data.qvel, *frames)

    def observe(self, features: np.ndarray) -> None:
        """Write the features ``(F,)`` of the current, fresh state."""
        np.concatenate(self._recorded, 0, features)

    def restore(self, state: np.ndarray) -> None:
        """Load a full integration state and the gripper pose the next step anchors to."""
        mujoco.mj_setState(self._model, self._data, state, INTEGRATION_STATE)
        mujoco.mj_kinematics(self._model, self._data)


class FetchDynamics:
    """Mocap control of the gripper.

    The first three numbers of a control row displace the mocap anchor, in metres. Features,
    for J one-dof joints: grip position (3), finger positions (2), qvel (V), and in world
    coordinates the joints' axes (3 J) and anchors (3 J), which give the grip's velocity
    without a Jacobian call. Tasks append their own.
    """

    open_loop = False  # the mocap target is re-anchored to the simulated gripper every step
    substeps = 20
    n_controls = 3

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        is_robot = (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) | (model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)
        self.n_joints = n = int(is_robot.sum())
        self.n_features = 5 + model.nv + 6 * n
        self._dt = self.substeps * model.opt.timestep
        right, left = (model.joint(f"robot0:{side}_gripper_finger_joint") for side in ("r", "l"))
        first = int(right.qposadr[0])
        if not is_robot[:n].all() or int(left.qposadr[0]) != first + 1:
            raise ValueError("the Fetch model has changed: expected one-dof joints first and neighbouring fingers")
        self.fingers = slice(first, first + 2)
        self._moves_grip = np.zeros(n)
        self._moves_grip[_joints_above(model, model.body("robot0:gripper_link").id)] = 1.0
        self._hinges = model.jnt_type[:n] == mujoco.mjtJoint.mjJNT_HINGE

    def control(self, actions: np.ndarray) -> np.ndarray:
        """Displacements ``(..., 3)`` in metres, in the float32 arithmetic Fetch itself uses."""
        clipped = np.clip(np.asarray(actions, np.float32)[..., :3], -1.0, 1.0)
        return (clipped * ACTION_SCALE).astype(np.float64)

    def simplify(self, model: mujoco.MjModel) -> None:
        """Let the lower arm pass table and box; the wall stays solid for it, and gripper and fingers meet everything.

        The arm hangs above the gripper: where it would touch table or box, the gripper mostly did before.
        """
        for name in REST:
            body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
            if body >= 0:
                first = model.body_geomadr[body]
                model.geom_conaffinity[first : first + model.body_geomnum[body]] &= ~ARM_BIT
                model.body_conaffinity[body] &= ~ARM_BIT  # of all its geoms; pairs of bodies are dropped by it

    def _grip_velocity(self, features: np.ndarray, out: np.ndarray) -> None:
        """Write the grip's velocity ``(..., 3)`` in metres per control step.

        Sum over the arm's joints: speed * axis for slides, speed * axis x lever for hinges.
        Element-wise arithmetic and sums along a contiguous last axis only, so that a batch of
        one and a batch of many agree to the bit.
        """
        n, first = self.n_joints, 5 + self.model.nv
        position, speeds = features[..., 0:3], features[..., 5 : 5 + n] * self._dt
        frames = features[..., first : first + 6 * n].reshape(*features.shape[:-1], 2, n, 3)
        axis = [frames[..., 0, :, i] for i in range(3)]
        lever = [position[..., i, None] - frames[..., 1, :, i] for i in range(3)]
        rates = speeds * self._moves_grip
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            turn = axis[j] * lever[k] - axis[k] * lever[j]
            moved = np.ascontiguousarray(rates * np.where(self._hinges, turn, axis[i]))
            out[..., i] = moved.sum(-1)


def _joints_above(model: mujoco.MjModel, body: int) -> list[int]:
    """Joints between the world and a body."""
    joints: list[int] = []
    while body:
        first = int(model.body_jntadr[body])
        joints += range(first, first + int(model.body_jntnum[body]))
        body = int(model.body_parentid[body])
    return joints


class ThinFetch(ABC):
    """A Fetch task with a thin step and, unless ``arm_self_collision``, a filtered arm.

    Without self-collision the arm's links still collide with table, wall and box, and gripper
    and fingers with everything; robot-against-itself and base-against-floor pairs are off,
    which makes a physics step up to twice as fast. Mixed in before a gymnasium-robotics class.
    """

    step_length = 0.033  # metres per control step along one axis at full speed
    grasps = False  # whether fingers need torsional friction
    model_spec: mujoco.MjSpec
    model: Any
    data: Any
    goal: np.ndarray
    np_random: np.random.Generator
    distance_threshold: float

    def __init__(self, arm_self_collision: bool = False, **kwargs: Any) -> None:
        self._arm_self_collision = arm_self_collision
        super().__init__(**kwargs)

    @property
    def camera(self) -> mujoco.MjvCamera:
        """Where videos are taken from: table, wall and arm."""
        camera = mujoco.MjvCamera()
        camera.lookat[:] = (1.25, 0.78, 0.5)
        camera.distance, camera.azimuth, camera.elevation = 1.6, 150.0, -32.0
        return camera

    @abstractmethod
    def _make_dynamics(self, model: mujoco.MjModel) -> Dynamics:
        """The task's physics."""

    def _build_model(self) -> mujoco.MjModel:
        self.model_spec = spec = mujoco.MjSpec.from_file(self.fullpath)
        self._add_obstacles(spec)
        if not self._arm_self_collision:
            filter_collisions(spec, self.grasps)
        return spec.compile()

    def _add_obstacles(self, spec: mujoco.MjSpec) -> None:  # noqa: B027 - most tasks have none
        """Add what stands in the way."""

    def _initialize_simulation(self) -> None:
        self.model = self._build_model()
        self.data = mujoco.MjData(self.model)
        self._model_names = self._utils.MujocoModelNames(self.model)
        self.model.vis.global_.offwidth = max(self.width, 640)
        self.model.vis.global_.offheight = max(self.height, 480)
        self.dynamics = self._make_dynamics(self.model)
        self._simulation = self.dynamics.bind(self.data)
        self._features = np.zeros((1, self.dynamics.n_features))
        self._env_setup(initial_qpos=self.initial_qpos)
        start = self.data
        self.initial_time, self.initial_qpos, self.initial_qvel = start.time, start.qpos.copy(), start.qvel.copy()

    def _env_setup(self, initial_qpos: Any) -> None:  # numbers by the names of their joints
        for name, value in initial_qpos.items():
            self.data.joint(name).qpos = value
        super()._env_setup({})  # type: ignore[misc]

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        """Advance one control step (0.04 s); same result as Fetch's own step, less Python."""
        if np.shape(action) != self.action_space.shape:
            raise ValueError(f"action has shape {np.shape(action)}, expected {self.action_space.shape}")
        self._advance(self.dynamics.control(action))
        if self.render_mode == "human":
            self.render()
        observation = self._observation()
        achieved = observation["achieved_goal"]
        reward, success = self.compute_reward(achieved, self.goal, {}), bool(self.reached(achieved, self.goal))
        return observation, float(reward), False, False, {"is_success": success}

    def _advance(self, control: np.ndarray) -> None:
        self._simulation.advance(control[None], self._features)

    def _get_obs(self) -> dict[str, np.ndarray]:
        self._simulation.observe(self._features[0])
        return self._observation()

    def _observation(self) -> dict[str, np.ndarray]:
        observation, achieved_goal = self.dynamics.observe(self._features[0].copy())
        return {"observation": observation, "achieved_goal": achieved_goal, "desired_goal": self.goal.copy()}

    def reached(self, achieved_goal: np.ndarray, desired_goal: np.ndarray) -> np.ndarray:
        """Tell for each pair of goals ``(..., 3)`` whether they are within 5 cm."""
        offset = np.asarray(achieved_goal) - np.asarray(desired_goal)
        return np.linalg.norm(offset, axis=-1) < self.distance_threshold

    @property
    def goal_radius(self) -> float:
        """Radius of the goal region in the world [m], for pictures."""
        return self.distance_threshold

    def goal_positions(self, goals: np.ndarray) -> np.ndarray:
        """Where goals ``(..., 3)`` lie in the world, for pictures."""
        return goals


class Walled:
    """A wall across the table, and a start on the near half. Mixed in before a task.

    The wall is wider than the table on purpose: around the far end of a table-wide wall the
    arm finds a way without lifting. Over the top is the only way.
    """

    WALL_Y, WALL_HALF_THICKNESS, WALL_X = 0.75, 0.02, (0.70, 1.80)
    TABLE_TOP = 0.40
    START_GRIP = np.array([1.34, 0.60, 0.50])

    def __init__(self, wall_height: float, **kwargs: Any) -> None:
        if kwargs.get("arm_self_collision"):
            raise ValueError("arm_self_collision=True does not go with a wall: the wall runs through the robot's base")
        self.wall_height = wall_height
        super().__init__(**kwargs)

    def _add_obstacles(self, spec: mujoco.MjSpec) -> None:
        # Down to the floor: beside the table nothing else is in the way.
        (near, far), top = self.WALL_X, self.TABLE_TOP + self.wall_height
        spec.worldbody.add_geom(
            name="wall",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[(near + far) / 2, self.WALL_Y, top / 2],
            size=[(far - near) / 2, self.WALL_HALF_THICKNESS, top / 2],
            solref=[0.01, 1.0],  # twice as stiff as the default: half the penetration
            rgba=[0.55, 0.27, 0.22, 0.8],
        )

    def _env_setup(self, initial_qpos: dict) -> None:
        super()._env_setup(initial_qpos)
        # Walk the gripper to the start in small increments, then let it settle.
        grip, control = self.data.site_xpos[self.model.site("robot0:grip").id], np.zeros(self.dynamics.n_controls)
        for _ in range(12):
            control[:3] = np.clip(self.START_GRIP - grip, -ACTION_SCALE, ACTION_SCALE)
            self._advance(control)
        for _ in range(5):
            self._advance(np.zeros_like(control))
        self.initial_gripper_xpos = grip.copy()


def filter_collisions(spec: mujoco.MjSpec, grasps: bool = False) -> None:
    """Switch off arm self-collision; keep arm and gripper solid against table, wall, box and base.

    A pair is tested when ``contype & conaffinity`` overlap in either direction. Gripper and
    fingers meet everything but the arm; the lower arm meets table, wall and box; base and
    torso meet the gripper only, so that it cannot slip past the wall through the robot.

    The gripper's collision mesh becomes the box fitted to it: contact between two boxes costs
    half of what mesh against box costs, and a plan that leans on the wall is all contact.
    """
    gripper = spec.body("robot0:gripper_link")
    hull = gripper.first_geom()
    gripper.add_geom(type=hull.type, meshname=hull.meshname, material=hull.material, contype=0, conaffinity=0)
    hull.type = mujoco.mjtGeom.mjGEOM_BOX  # fitted to the mesh by the compiler
    hull.group = 3  # not drawn
    for body in spec.bodies:
        for geom in body.geoms:
            if not (geom.contype or geom.conaffinity):
                continue
            if body.name in GRIPPER_BODIES:
                geom.conaffinity = 1 | BASE_BIT
                if not grasps:
                    geom.condim = 3  # sliding friction only: torsion matters for grasping alone
            elif body.name in LOWER_ARM_BODIES:
                geom.contype, geom.conaffinity = ARM_BIT, 0
            elif body.name in BASE_BODIES:
                geom.contype, geom.conaffinity = BASE_BIT, 0
            elif body.name.startswith("robot0:"):
                geom.contype, geom.conaffinity = 0, 0
            elif body.name in REST or geom.name == "wall":
                geom.conaffinity = 1 | ARM_BIT
