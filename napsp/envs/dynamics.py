"""The physics of a task, written once: one control step as functions of ``(model, data)``.

An environment calls these functions on its own ``MjData``; the rollout engine in ``mpc``
calls the very same functions on one ``MjData`` per worker. That is why a planned
trajectory and the executed one agree bit for bit.
"""

from __future__ import annotations

from typing import Protocol

import mujoco
import numpy as np

INTEGRATION_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class Simulation(Protocol):
    """A task's dynamics bound to one ``MjData``."""

    def advance(self, controls: np.ndarray, features: np.ndarray) -> None:
        """Run the control steps of rows ``(n, U)``; write what each one leads to, ``(n, F)``."""
        ...

    def observe(self, features: np.ndarray) -> None:
        """Write the features ``(F,)`` of the current state."""
        ...

    def restore(self, state: np.ndarray) -> None:
        """Put the data into a state taken by :func:`get_state`."""
        ...


class Dynamics(Protocol):
    """What a task offers to its environment and to the planners.

    Shapes: A action, U control row, F features, O observation, G goal; ``...`` any batch.
    Everything batched must be element-wise arithmetic (no reductions, no matrix
    products), because only then is a batch of one bit-identical to a batch of many.
    """

    model: mujoco.MjModel
    substeps: int
    n_features: int
    open_loop: bool
    """True when a control row does not depend on the simulated state, so that a whole
    horizon can be handed to one ``mujoco.rollout`` call (features are then qpos, qvel)."""

    def bind(self, data: mujoco.MjData) -> Simulation:
        """Prepare to simulate on ``data``."""
        ...

    def control(self, actions: np.ndarray) -> np.ndarray:
        """Map actions ``(..., A)`` in [-1, 1] to control rows ``(..., U)``, float64."""
        ...

    def observe(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Turn features ``(..., F)`` into observation ``(..., O)`` and achieved goal ``(..., G)``."""
        ...


def get_state(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return everything the next ``mj_step`` reads: ``mjSTATE_INTEGRATION``, float64 ``(S,)``.

    Besides time, qpos, qvel and act it holds qacc_warmstart, ctrl and the mocap pose;
    without the warm start a rollout in contact drifts away from the environment.
    """
    state = np.empty(mujoco.mj_stateSize(model, INTEGRATION_STATE))
    mujoco.mj_getState(model, data, state, INTEGRATION_STATE)
    return state


STATE_SIZES = ("nq", "nv", "na", "nu", "nmocap", "nbody", "neq", "nuserdata", "npluginstate")
STATE_MEANING = ("jnt_type", "jnt_qposadr", "body_parentid", "body_mocapid", "actuator_trnid")


def check_same_state(model: mujoco.MjModel, other: mujoco.MjModel) -> None:
    """Check that a state of ``model`` can be loaded into ``other`` and means the same joints and bodies there.

    Where obstacles stand is not compared: a planner may ignore some on purpose.

    Raises:
        ValueError: the models differ in their joints, actuators, mocap or other bodies.
    """
    if model is other:
        return
    differ = [
        f"{n} {getattr(model, n)} and {getattr(other, n)}"
        for n in STATE_SIZES
        if getattr(model, n) != getattr(other, n)
    ]
    if not differ:
        differ = [n for n in STATE_MEANING if not np.array_equal(getattr(model, n), getattr(other, n))]
    if differ:
        raise ValueError(
            f"a state of the environment does not fit the model that is planned in ({', '.join(differ)}); "
            "plan in a copy of the environment's model, see napsp.envs.coarse"
        )
