"""The smallest dynamics, which a large force blows up."""

import mujoco
import numpy as np

from napsp.envs.dynamics import INTEGRATION_STATE


class Explosive:
    """One slide joint that blows up under a large force."""

    open_loop, substeps, n_features = True, 5, 2

    def __init__(self, open_loop):
        self.open_loop = open_loop
        self.model = mujoco.MjModel.from_xml_string("""
            <mujoco><option timestep="0.01" integrator="Euler"/><worldbody><body>
            <joint name="x" type="slide"/><geom size="0.1" mass="1e-4"/></body></worldbody>
            <actuator><motor joint="x" gear="1e9"/></actuator></mujoco>""")

    def bind(self, data):
        return Bound(self, data)

    def control(self, actions):
        return np.asarray(actions, np.float64)

    def observe(self, features):
        return features, features


class Bound:
    def __init__(self, dynamics, data):
        self.model, self.data, self.substeps = dynamics.model, data, dynamics.substeps

    def advance(self, controls, features):
        for control, row in zip(controls, features, strict=True):
            self.data.ctrl[:] = control
            mujoco.mj_step(self.model, self.data, self.substeps)
            row[:] = self.data.qpos[0], self.data.qvel[0]

    def restore(self, state):
        mujoco.mj_setState(self.model, self.data, state, INTEGRATION_STATE)
