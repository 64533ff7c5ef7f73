"""Goal tasks on models that hypothesis draws from parts."""

import mujoco
import numpy as np
from hypothesis import strategies as st

from napsp.envs.dynamics import INTEGRATION_STATE
from napsp.envs.open_loop import OpenLoopDynamics, OpenLoopEnv

SLEEPS, DELAYS_THERE = hasattr(mujoco.mjtEnableBit, "mjENBL_SLEEP"), hasattr(mujoco.mjtState, "mjSTATE_HISTORY")
JOINTS = (
    '<joint name="j{i}" type="hinge" axis="{axis}" damping=".1"/>',
    '<joint name="j{i}" type="hinge" axis="{axis}" range="-40 60" limited="true" frictionloss=".05" armature=".01"/>',
    '<joint name="j{i}" type="slide" axis="{axis}" damping="2" stiffness="20"/>',
    '<joint name="j{i}" type="slide" axis="{axis}" range="-.1 .3" limited="true" damping="1"/>',
)
AXES = ("1 0 0", "0 1 0", "0 0 1", "1 1 0")
GEOMS = (
    '<geom type="sphere" size=".08" mass="1"/>',
    '<geom type="capsule" size=".04" fromto="0 0 0 0 .2 0" condim="{condim}"/>',
    '<geom type="box" size=".1 .05 .06" density="400" condim="{condim}"/>',
    '<geom type="ellipsoid" size=".1 .05 .06" density="400"/>',
    '<geom type="cylinder" size=".05 .1" density="400" condim="{condim}"/>',
)
ACTUATORS = (
    '<motor {on} gear="5" ctrlrange="-1 1"{late}/>',
    '<position {on} kp="20" ctrlrange="-.2 1"{late}/>',
    '<velocity {on} kv="2" ctrlrange="-1 1"{late}/>',
    '<intvelocity {on} kp="10" actrange="-.5 .5" ctrlrange="-1 1"{late}/>',
    '<general {on} dyntype="filter" dynprm=".1" gainprm="10" ctrlrange="-1 1"{late}/>',
    '<general {on} dyntype="filterexact" dynprm=".05" gainprm="10" ctrlrange="-1 1" actearly="true"{late}/>',
    '<general {on} dyntype="integrator" biastype="affine" biasprm="0 -1 -.1" actlimited="true" actrange="-1 1"{late}/>',
    '<muscle {on} force="20" lengthrange="-1 1.4" ctrlrange="0 1"{late}/>',
)
DELAYS = ("", "", ' delay=".03" nsample="6"', ' delay=".02" nsample="4" interp="linear"')
EQUALITIES = (
    '<connect name="e" body1="b0" anchor="0 0 .1" active="{active}"/>',
    '<weld name="e" body1="b0" body2="hand" active="{active}"/>',
    '<joint joint1="j0" polycoef="0 0 0 0 0" active="{active}"/>',
)
TENDONS = (
    '<fixed name="t"><joint joint="j0" coef="1"/></fixed>',
    '<spatial name="t" limited="true" range="0 .6" stiffness="5" damping=".2"><site site="s0"/><site site="top"/>'
    "</spatial>",
)
SENSORS = ('<jointpos joint="j0"/>', '<touch site="s0"/>', '<accelerometer site="s0"/>', "<clock/>")
OPTIONS = (
    'integrator="Euler"', 'integrator="implicit"', 'integrator="implicitfast"', 'integrator="RK4"',
    'cone="elliptic" impratio="3"', 'solver="CG"', 'solver="PGS" noslip_iterations="3"', 'jacobian="sparse"',
    'wind="1 0 0" density="1.2" viscosity=".01"',
)  # fmt: skip
FLAGS = ("", "", '<flag warmstart="disable"/>', '<flag island="enable"/>', '<flag multiccd="enable"/>',
         '<flag autoreset="disable"/>', *(['<flag sleep="enable"/>'] if SLEEPS else []))  # fmt: skip


@st.composite
def models(draw):
    """XML of a random model: up to three arms in a row, a box that is free, a floor, a hand that is mocap."""

    def pick(parts, **names):
        return draw(st.sampled_from(parts)).format(**names)

    n = draw(st.integers(1, 3))
    arms = (
        "".join(
            f'<body name="b{i}" pos="0 {0.1 if i else 0} {0 if i else 0.08}">'
            + pick(JOINTS, i=i, axis=draw(st.sampled_from(AXES)))
            + pick(GEOMS, condim=draw(st.sampled_from((1, 3, 4, 6))))
            + f'<site name="s{i}" pos="0 .1 0"/>'
            for i in range(n)
        )
        + "</body>" * n
    )
    free = '<body name="box" pos=".2 .1 .08"><freejoint/><geom type="box" size=".08 .08 .08" density="300"/></body>'
    ball = (
        '<body name="ball" pos="-.3 0 .3"><joint type="ball" damping=".05"/>'
        '<geom type="capsule" size=".04" fromto="0 0 0 .1 0 -.2"/></body>'
    )
    hand = '<body name="hand" mocap="true" pos="0 .4 .3"><geom type="box" size=".05 .05 .05"/></body>'
    others = "".join(body for body in (free, ball) if draw(st.booleans()))
    tendon = pick(TENDONS) if draw(st.booleans()) else ""
    equality = pick(EQUALITIES, active=draw(st.sampled_from(("true", "false")))) if draw(st.booleans()) else ""
    delays = DELAYS if DELAYS_THERE else ("",)
    actuators = "".join(pick(ACTUATORS, on=f'joint="j{i}"', late=draw(st.sampled_from(delays))) for i in range(n))
    if tendon and draw(st.booleans()):
        actuators += '<motor tendon="t" gear="3" ctrlrange="-1 1"/>'
    sensors = "".join(sensor for sensor in SENSORS if draw(st.booleans()))
    floor = draw(st.sampled_from(("", *3 * ['<geom type="plane" size="3 3 .1"/>'])))
    userdata = draw(st.sampled_from((0, 0, 3)))
    return (
        f'<mujoco><size nuserdata="{userdata}"/><option timestep=".005" {pick(OPTIONS)}>{pick(FLAGS)}</option>'
        f'<worldbody>{floor}<site name="top" pos="0 0 .5"/>{arms}{others}{hand}</worldbody>'
        f"<tendon>{tendon}</tendon><equality>{equality}</equality><sensor>{sensors}</sensor>"
        f"<actuator>{actuators}</actuator></mujoco>"
    )


class Held(OpenLoopDynamics):
    """Actions are controls; a whole horizon may be one call of mujoco.rollout."""

    substeps = 4

    def control(self, actions):
        low, high = self.model.actuator_ctrlrange.T
        return low + 0.5 * (np.clip(np.asarray(actions, np.float64), -1, 1) + 1) * (high - low)

    def observe(self, features):
        return features, features[..., :1]  # views, as a user may return them


class Reacting(Held):
    """Controls that react to the state and the clock, a hand that swings with it, and all that can be measured."""

    open_loop = False

    def __init__(self, model):
        super().__init__(model)
        self.n_features = 1 + model.nq + model.nv + model.na + model.nsensordata

    def bind(self, data):
        return Reaction(self, data)


class Reaction:
    def __init__(self, dynamics, data):
        self.model, self.data, self.substeps = dynamics.model, data, dynamics.substeps

    def advance(self, controls, features):
        data = self.data
        for control, row in zip(controls, features, strict=True):
            for _ in range(self.substeps):
                data.ctrl[:] = control - 0.1 * data.qvel[0] + 0.05 * np.sin(9.0 * data.time)
                data.mocap_pos[0, 0] = 0.2 * np.cos(3.0 * data.time)
                mujoco.mj_step(self.model, data)
            self.observe(row)

    def observe(self, features):
        data = self.data
        np.concatenate(([data.time], data.qpos, data.qvel, data.act, data.sensordata), out=features)

    def restore(self, state):
        mujoco.mj_setState(self.model, self.data, state, INTEGRATION_STATE)


DISTURBANCES = ("mocap", "equality", "body force", "joint force", "userdata", "late", "before zero")


class Drawn(OpenLoopEnv):
    """A task whose reset sets more than positions and velocities."""

    def __init__(self, xml, kind, disturbed):
        self.disturbed = disturbed
        super().__init__(kind(mujoco.MjModel.from_xml_string(xml)), 0.05, None)

    def _start(self):
        data, rng, disturbed = self.data, self.np_random, self.disturbed
        mujoco.mj_resetData(self.model, data)
        data.qvel[:] = rng.normal(0, 0.3, self.model.nv)
        if "mocap" in disturbed:
            data.mocap_pos[0], data.mocap_quat[0] = rng.uniform(-0.3, 0.3, 3), [0.6, 0.8, 0, 0]
        if "equality" in disturbed:
            data.eq_active[:] = 1 - data.eq_active
        if "body force" in disturbed:
            data.xfrc_applied[-1] = rng.normal(0, 2, 6)
        if "joint force" in disturbed:
            data.qfrc_applied[:] = rng.normal(0, 0.5, self.model.nv)
        if "userdata" in disturbed:
            data.userdata[:] = rng.normal(size=self.model.nuserdata)
        data.time = 7.3 if "late" in disturbed else -0.01 if "before zero" in disturbed else 0.0
        self.goal = np.zeros(1)

    def goal_positions(self, goals):
        return np.zeros((*goals.shape[:-1], 3))


@st.composite
def drawn_tasks(draw):
    """A task that is reset, and how many steps it is to run before a plan is made."""
    xml, kind = draw(models()), draw(st.sampled_from((Held, Held, Reacting)))
    disturbed, before = draw(st.sets(st.sampled_from(DISTURBANCES), max_size=3)), draw(st.sampled_from((0, 1, 4)))
    if "sleep" in xml and draw(st.booleans()):  # rest until what can sleep does
        disturbed, before = disturbed - {"body force", "joint force"}, 80
    task = Drawn(xml, kind, disturbed)
    task.reset(seed=draw(st.integers(0, 9)))
    return task, before
