"""gymnasium-robotics and the enums of MuJoCo from 3.12 on.

There a member no longer equals a numpy integer that stands on the right (``mjJNT_HINGE == model.jnt_type[0]``), which
is what ``in`` asks, and gymnasium-robotics 1.4.2 reads and writes the position of a joint only ``in`` known types.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import mujoco
from gymnasium_robotics.utils import mujoco_utils

_HINGE = "<mujoco><worldbody><body><joint name='hinge'/><geom size='1'/></body></worldbody></mujoco>"


class _WithNumbers:
    """MuJoCo's module, but for the types of joints, which are whole numbers."""

    mjtJoint = SimpleNamespace(  # noqa: N815 - MuJoCo's name
        **{name: int(kind) for name, kind in mujoco.mjtJoint.__members__.items()}
    )

    def __getattr__(self, name: str) -> Any:
        return getattr(mujoco, name)


def mend_joint_types() -> None:
    """Let gymnasium-robotics set and read joints, where it can not: its robots could not even begin.

    The one place that changes somebody else's code. It tries a hinge, and does nothing once the library is right.
    """
    model = mujoco.MjModel.from_xml_string(_HINGE)
    try:
        mujoco_utils.get_joint_qpos(model, mujoco.MjData(model), "hinge")
    except AssertionError:
        mujoco_utils.mujoco = _WithNumbers()
