"""A task of your own in one file: a two-link arm that has to fold to pass a post.

Put such a file into the folder you work in (or anywhere on the Python path) and name its class:

    python -m napsp.train --env two_link_arm:TwoLinkArm
    python -m planners.mppi --env two_link_arm:TwoLinkArm --checkpoint runs/two_link_arm-TwoLinkArm-ours-s0
    python -m planners.mppi --env two_link_arm:TwoLinkArm --cost euclidean        # the straight line instead

Three things make a task: a MuJoCo model, how actions become controls and simulated states become
observations (the dynamics, shared by environment and planner), and how an episode starts. Here the
controls do not depend on the simulated state, so ``napsp.envs.open_loop`` does the rest.
"""

import mujoco
import numpy as np

from napsp.envs.open_loop import OpenLoopDynamics, OpenLoopEnv

LINK = 0.5  # metres
SPEED = 2.0  # radians per second at full action
MODEL = f"""
<mujoco model="two_link_arm">
  <option timestep="0.01" gravity="0 0 0" integrator="implicitfast"/>
  <visual><global offwidth="640" offheight="480"/></visual>
  <default><joint type="hinge" axis="0 0 1" damping="1"/><geom rgba="0.1 0.35 0.8 1" density="1000"/></default>
  <worldbody>
    <light pos="0 0 3"/>
    <camera name="top" pos="0.4 0 2.6" fovy="45"/>
    <geom type="plane" size="2 2 0.1" pos="0 0 -0.1" rgba="0.93 0.93 0.9 1" contype="0" conaffinity="0"/>
    <geom name="post" type="cylinder" size="0.06 0.1" pos="0.75 0 0" rgba="0.35 0.38 0.45 1"/>
    <body name="upper">
      <joint name="shoulder"/>
      <geom type="capsule" size="0.03" fromto="0 0 0 {LINK} 0 0"/>
      <body name="lower" pos="{LINK} 0 0">
        <joint name="elbow" range="-150 150" limited="true"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 {LINK} 0 0"/>
      </body>
    </body>
  </worldbody>
  <contact><exclude body1="upper" body2="lower"/></contact>
  <actuator>
    <velocity joint="shoulder" kv="20" ctrlrange="-{SPEED} {SPEED}" ctrllimited="true"/>
    <velocity joint="elbow" kv="20" ctrlrange="-{SPEED} {SPEED}" ctrllimited="true"/>
  </actuator>
</mujoco>"""


class TwoLinkArmDynamics(OpenLoopDynamics):
    """A control row holds both joints' target speeds; features are both angles and both speeds."""

    substeps = 10  # a control step lasts 0.1 s

    def control(self, actions):
        """Target speeds ``(..., 2)`` in rad/s."""
        return SPEED * np.clip(np.asarray(actions, np.float64), -1.0, 1.0)

    def observe(self, features):
        """Observation: cosines, sines and speeds of both joints ``(..., 6)``; goal: the fingertip ``(..., 2)`` [m].

        Element-wise arithmetic only, so that one state and a batch of them give the same numbers to the bit.
        """
        shoulder, elbow = features[..., 0], features[..., 1]
        tip = np.stack(
            [
                LINK * (np.cos(shoulder) + np.cos(shoulder + elbow)),
                LINK * (np.sin(shoulder) + np.sin(shoulder + elbow)),
            ],
            axis=-1,
        )
        angles = [np.cos(shoulder), np.cos(elbow), np.sin(shoulder), np.sin(elbow)]
        return np.stack([*angles, features[..., 2], features[..., 3]], axis=-1), tip


class TwoLinkArm(OpenLoopEnv):
    """Start stretched out on one side of the post; bring the fingertip within 5 cm of a goal on the other side."""

    max_episode_steps = 40
    camera = "top"
    step_length = 0.2  # metres of fingertip motion per control step at full speed, for the Euclidean cost

    def __init__(self, render_mode=None):
        model = mujoco.MjModel.from_xml_string(MODEL)
        super().__init__(TwoLinkArmDynamics(model), distance_threshold=0.05, render_mode=render_mode)

    def _start(self):
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self.np_random.uniform(-1.0, -0.5), self.np_random.uniform(-0.3, 0.3)
        angle, radius = self.np_random.uniform(0.4, 1.0), self.np_random.uniform(0.7, 0.95)
        self.goal = radius * np.array([np.cos(angle), np.sin(angle)])

    def goal_positions(self, goals):
        """Where goals ``(..., 2)`` lie in the world, ``(..., 3)``."""
        return np.concatenate([goals, np.zeros((*goals.shape[:-1], 1))], axis=-1)
