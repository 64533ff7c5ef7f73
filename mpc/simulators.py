"""What one worker of a rollout engine simulates with, and which states it starts from.

The engine asks dynamics for ``simulator()`` and ``state_of(world)``; those without are physics on an ``MjData``.
"""

from __future__ import annotations

from typing import Any, Protocol

import mujoco
import numpy as np

from mpc.divergence import blew_up, watch
from napsp.envs.dynamics import Dynamics
from napsp.envs.state import check_same_state, get_state, put_state

State = Any
"""All that the next step reads, picklable: of MuJoCo an array ``(S,)`` of :func:`napsp.envs.state.get_state`."""


class Simulator(Protocol):
    """One world to simulate in; every worker has its own."""

    def begin(self, state: State) -> None:
        """Put the world into a state, and begin to look out for a blow-up."""
        ...

    def advance(self, controls: np.ndarray, features: np.ndarray) -> None:
        """Run the control steps of rows ``(n, U)``; write what each one leads to, ``(n, F)``."""
        ...

    def blew_up(self) -> bool:
        """Whether what was simulated since :meth:`begin` is none that a plan may lead to."""
        ...

    def state(self) -> State:
        """The state that the world is in now."""
        ...


class MujocoSimulator:
    """Physics on an ``MjData`` of its own.

    Attributes:
        simulation: of the dynamics, bound to ``data``.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self.data = mujoco.MjData(dynamics.model)
        self.simulation, self._model = dynamics.bind(self.data), dynamics.model

    def load(self, state: State) -> None:
        """Put the data into a state."""
        put_state(self.simulation, self._model, self.data, state)

    def begin(self, state: State) -> None:
        """Put the data into a state; :meth:`blew_up` speaks of what follows."""
        put_state(self.simulation, self._model, self.data, state)
        watch(self.data)

    def advance(self, controls: np.ndarray, features: np.ndarray) -> None:
        """Run the control steps of rows ``(n, U)``; write what each one leads to, ``(n, F)``."""
        self.simulation.advance(controls, features)

    def blew_up(self) -> bool:
        """Whether MuJoCo warned since :meth:`begin`."""
        return blew_up(self.data)

    def state(self) -> State:
        """The integration state ``(S,)``."""
        return get_state(self._model, self.data)


def simulators(dynamics: Any, n: int) -> list[Any]:
    """One for each of ``n`` workers; a world takes megabytes, so they are kept, never made per sample."""
    make = getattr(dynamics, "simulator", None)
    return [MujocoSimulator(dynamics) if make is None else make() for _ in range(n)]


def state_of(dynamics: Any, world: Any) -> State:
    """The state of an environment (unwrapped), to simulate from in ``dynamics``.

    Raises:
        ValueError: the model of the dynamics has another state.
    """
    own = getattr(dynamics, "state_of", None)
    if own is not None:
        return own(world)
    check_same_state(world.model, dynamics.model)
    return get_state(world.model, world.data)
