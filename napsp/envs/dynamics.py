"""The physics of a task, written once: one control step as functions of ``(model, data)``.

An environment calls these functions on its own ``MjData``; the rollout engine in ``mpc``
calls the very same functions on one ``MjData`` per worker. That is why a planned
trajectory and the executed one agree bit for bit.
"""

from __future__ import annotations

from typing import Protocol

import mujoco
import numpy as np

from napsp.envs.state import INTEGRATION_STATE, get_state

__all__ = ["INTEGRATION_STATE", "Dynamics", "Simulation", "get_state"]


class Simulation(Protocol):
    """A task's dynamics bound to one ``MjData``."""

    def advance(self, controls: np.ndarray, features: np.ndarray) -> None:
        """Run the control steps of rows ``(n, U)``; write what each one leads to, ``(n, F)``."""
        ...

    def observe(self, features: np.ndarray) -> None:
        """Write the features ``(F,)`` of the current state."""
        ...

    def restore(self, state: np.ndarray) -> None:
        """Put the data into a state, ``mjSTATE_INTEGRATION``; bring up to date what ``advance`` reads before it steps.

        Poses say: MuJoCo computes them in the first step. ``mj_kinematics`` does, where ``mj_forward`` would move the
        warm start.
        """
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
    horizon can be handed to one ``mujoco.rollout`` call (features are then qpos, qvel).
    Where the state holds more than that call takes, it is stepped all the same."""

    def bind(self, data: mujoco.MjData) -> Simulation:
        """Prepare to simulate on ``data``."""
        ...

    def control(self, actions: np.ndarray) -> np.ndarray:
        """Map actions ``(..., A)`` in [-1, 1] to control rows ``(..., U)``, float64."""
        ...

    def observe(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Turn features ``(..., F)`` into observation ``(..., O)`` and achieved goal ``(..., G)``."""
        ...
