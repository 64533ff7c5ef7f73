"""A simulator's state: everything the next ``mj_step`` reads, taken from one ``MjData`` and put into another."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

INTEGRATION_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
# Which trees of bodies sleep is no part of MuJoCo's own states. The first array decides, the others follow from it,
# but MuJoCo takes a disagreement between them for a change by the user and wakes the tree.
SLEEP_ARRAYS = ("tree_asleep", "tree_awake", "body_awake", "body_awake_ind", "dof_awake_ind", "parent_awake_ind")
SLEEP_COUNTS = ("ntree_awake", "nbody_awake", "nparent_awake", "nv_awake")
_SLEEP = int(getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", 0))  # later than MuJoCo 3.3

STATE_SIZES = ("nq", "nv", "na", "nu", "nmocap", "nbody", "neq", "nuserdata", "npluginstate", "nhistory")
STATE_MEANING = ("jnt_type", "jnt_qposadr", "body_parentid", "body_mocapid", "actuator_trnid")


def get_state(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return everything the next ``mj_step`` reads, float64 ``(S,)``: ``mjSTATE_INTEGRATION``, and who sleeps.

    Besides time, qpos, qvel and act it holds qacc_warmstart, ctrl, the mocap pose, applied forces, active equalities,
    and what delays, plugins and the user keep; without the warm start a rollout in contact drifts away from the
    environment. In models with sleeping enabled what follows is which bodies sleep.
    """
    state = np.empty(mujoco.mj_stateSize(model, INTEGRATION_STATE))
    mujoco.mj_getState(model, data, state, INTEGRATION_STATE)
    if not may_sleep(model):
        return state
    counts = np.array([getattr(data, name) for name in SLEEP_COUNTS], np.float64)
    return np.concatenate([state, *(getattr(data, name) for name in SLEEP_ARRAYS), counts])


def put_state(simulation: Any, model: mujoco.MjModel, data: mujoco.MjData, state: np.ndarray) -> None:
    """Put ``data``, and the simulation bound to it, into a state ``(S,)`` of :func:`get_state`.

    The simulation's own ``restore`` gets the part that is MuJoCo's.
    """
    if not may_sleep(model):
        simulation.restore(state)
        return
    n = mujoco.mj_stateSize(model, INTEGRATION_STATE)
    data.tree_awake[:] = 1  # a tree that slept here wakes, or its old poses would stay
    simulation.restore(state[:n])
    mujoco.mj_forward(model, data)  # what sleeps from here on keeps the poses that it has now
    simulation.restore(state[:n])  # without the warm start that mj_forward has left
    for name in SLEEP_ARRAYS:
        values = getattr(data, name)
        values[:] = state[n : n + len(values)]
        n += len(values)
    for name, count in zip(SLEEP_COUNTS, state[n:], strict=True):
        setattr(data, name, int(count))


def may_sleep(model: mujoco.MjModel) -> bool:
    """Whether bodies at rest are left out of the simulation until something wakes them."""
    return bool(model.opt.enableflags & _SLEEP)


def check_same_state(model: mujoco.MjModel, other: mujoco.MjModel) -> None:
    """Check that a state of ``model`` can be loaded into ``other`` and means the same joints and bodies there.

    Where obstacles stand is not compared: a planner may ignore some on purpose.

    Raises:
        ValueError: the models differ in their joints, actuators, mocap or other bodies.
    """
    if model is other:
        return
    sizes = {n: (getattr(model, n, 0), getattr(other, n, 0)) for n in STATE_SIZES}
    differ = [f"{n} {own} and {others}" for n, (own, others) in sizes.items() if own != others]
    if not differ:
        differ = [n for n in STATE_MEANING if not np.array_equal(getattr(model, n), getattr(other, n))]
    if differ:
        raise ValueError(
            f"a state of the environment does not fit the model that is planned in ({', '.join(differ)}); "
            "plan in a copy of the environment's model, see napsp.envs.coarse"
        )
