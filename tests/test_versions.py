"""Versions of MuJoCo whose enums do not equal numpy's integers, and a gymnasium-robotics that asks for it."""

import mujoco
import numpy as np
import pytest
from gymnasium_robotics.utils import mujoco_utils

from napsp import envs
from napsp.envs.joint_types import mend_joint_types

JOINTS = """<mujoco><worldbody>
    <body><joint name="hinge" type="hinge"/><geom size="1"/></body>
    <body><joint name="slide" type="slide"/><geom size="1"/></body>
    <body><freejoint name="free"/><geom size="1"/></body>
</worldbody></mujoco>"""


@pytest.fixture
def unmended(monkeypatch):
    monkeypatch.setattr(mujoco_utils, "mujoco", mujoco)


@pytest.mark.parametrize(("joint", "n_qpos", "n_qvel"), [("hinge", 1, 1), ("slide", 1, 1), ("free", 7, 6)])
def test_gymnasium_robotics_sets_and_reads_joints(joint, n_qpos, n_qvel, unmended):
    mend_joint_types()
    model = mujoco.MjModel.from_xml_string(JOINTS)
    data = mujoco.MjData(model)
    for part, n in (("qpos", n_qpos), ("qvel", n_qvel)):
        value = np.arange(1.0, n + 1)
        getattr(mujoco_utils, f"set_joint_{part}")(model, data, joint, value)
        np.testing.assert_array_equal(getattr(mujoco_utils, f"get_joint_{part}")(model, data, joint).ravel(), value)
        np.testing.assert_array_equal(getattr(data.joint(joint), part), value)


def test_a_library_that_is_right_is_left_alone(unmended, monkeypatch):
    monkeypatch.setattr(mujoco_utils, "get_joint_qpos", lambda model, data, name: data.joint(name).qpos)
    mend_joint_types()
    assert mujoco_utils.mujoco is mujoco


@pytest.mark.parametrize("name", ["fetch_reach", "fetch_wall", "fetch_pick_place", "fetch_pick_place_wall", "claw"])
def test_tasks_of_this_package_do_without(name, monkeypatch):
    def broken(*_):
        raise AssertionError("a type of joint it does not know")

    for part in ("set_joint_qpos", "get_joint_qpos", "set_joint_qvel", "get_joint_qvel"):
        monkeypatch.setattr(mujoco_utils, part, broken)
    env = envs.make(name)
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape, np.float32))
    env.close()


@pytest.mark.parametrize("name", ["FetchPush-v4", "HandReach-v3"])
def test_stock_robots_are_mended_when_they_are_made(name, unmended):
    env = envs.make(name)
    env.reset(seed=0)
    env.close()
