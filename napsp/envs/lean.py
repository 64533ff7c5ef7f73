"""A task's model without what only pictures show: planning in it gives the same numbers sooner.

MuJoCo moves every camera, light and visual shape in every physics step.
"""

from __future__ import annotations

import copy
from typing import Any, TypeVar

import mujoco
import numpy as np

from napsp.envs.dynamics import Dynamics

D = TypeVar("D", bound=Dynamics)

PHYSICS = ("body_", "jnt_", "dof_", "eq_", "actuator_", "tendon_", "site_", "geom_")
SHAPES = ("adr", "num")  # endings of the numbers that say which shapes a body has


def lean(dynamics: D, spec: mujoco.MjSpec | None) -> D:
    """Return the same dynamics on a model without visual geoms, cameras and lights.

    Rollouts agree with the environment's to the bit. As for :func:`napsp.envs.coarse.coarse`, what ``dynamics`` has
    derived from its model must hold for both.

    Args:
        dynamics: the environment's.
        spec: what their model was compiled from; without it they are returned as they are.
    """
    if spec is None:
        return dynamics
    planned = copy.copy(dynamics)
    planned.model = _without_decoration(spec.copy(), dynamics.model)
    return planned


def _without_decoration(spec: Any, model: mujoco.MjModel) -> mujoco.MjModel:
    shown = [geom for geom in spec.geoms if not (geom.contype or geom.conaffinity)]
    kept = np.setdiff1d(np.arange(model.ngeom), [geom.id for geom in shown])
    for element in (*spec.cameras, *spec.lights, *shown):
        # mujoco < 3.3.3 has the one, later versions the other
        spec.delete(element) if hasattr(spec, "delete") else element.delete()
    for body in spec.bodies:
        i, body.explicitinertial = body.id, True  # visual geoms may have mass
        body.mass, body.inertia = model.body_mass[i], model.body_inertia[i]
        body.ipos, body.iquat = model.body_ipos[i], model.body_iquat[i]
    stripped = spec.compile()
    for name in dir(model.opt):
        if not name.startswith("_") and not callable(getattr(model.opt, name)):
            setattr(stripped.opt, name, getattr(model.opt, name))
    for name in dir(model):  # also what an environment has changed since it compiled
        if name.startswith(PHYSICS) and not name.endswith(SHAPES) and isinstance(getattr(model, name), np.ndarray):
            values = getattr(model, name)
            getattr(stripped, name)[...] = values[kept] if name.startswith("geom_") else values
    return stripped
