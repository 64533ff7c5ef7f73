"""A coarser model of a task to plan in: fewer, longer physics steps per control step.

The environment itself never runs it. Model and environment share their state, so the whole
integration state of the one loads into the other, and a control step lasts as long in both.
"""

from __future__ import annotations

import copy
from typing import TypeVar

from napsp.envs.dynamics import Dynamics

D = TypeVar("D", bound=Dynamics)


def coarse(dynamics: D, n_substeps: int, fewer_collisions: bool = True) -> D:
    """Return the same task's dynamics with ``n_substeps`` physics steps per control step.

    They are a copy bound to a copy of the model, so what ``dynamics`` has derived from the
    model must hold for both; ``bind`` has to read ``self.model`` and ``self.substeps``. What an
    environment changes in its model later, from episode to episode say, the copy does not see.

    Args:
        dynamics: the environment's.
        n_substeps: the time step grows by as much as they are fewer.
        fewer_collisions: also leave out the collisions that the task can plan without: its
            ``simplify(model)``, if it has one, switches them off in place.

    Raises:
        ValueError: more substeps than the environment's, or none.
    """
    if not 1 <= n_substeps <= dynamics.substeps:
        raise ValueError(f"{n_substeps} substeps are not coarser than the task's own; give 1 to {dynamics.substeps}")
    planned = copy.copy(dynamics)
    planned.model = copy.deepcopy(dynamics.model)
    planned.model.opt.timestep *= dynamics.substeps / n_substeps
    planned.substeps = n_substeps
    simplify = getattr(planned, "simplify", None)
    if fewer_collisions and simplify is not None:
        simplify(planned.model)
    return planned
