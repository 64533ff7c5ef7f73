"""A task's model without what only pictures show: planning in it gives the same numbers sooner.

MuJoCo moves every camera, light and visual shape in every physics step.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, TypeVar

import mujoco
import numpy as np

from napsp.envs.dynamics import INTEGRATION_STATE, Dynamics

D = TypeVar("D", bound=Dynamics)

# Not to be copied from the whole model: addresses, bounding volumes, names, and what is left out.
OWN = ("name", "bvh_", "cam_", "light_", "mat_", "tex_", "body_bvh", "body_geom", "mesh_bvh", "oct_", "_")
# What may refer to shapes by number, so that leaving some out would confuse it.
REFERRING = ("nsensor", "npair", "ntendon", "nflex", "nskin", "nplugin")
N_COMPARED = 3  # control steps


def lean(dynamics: D, spec: mujoco.MjSpec | None, n_actions: int) -> D:
    """Return the same dynamics on a model without visual geoms, cameras and lights.

    Shapes have other numbers there, so this is for dynamics whose class says ``reads_shapes = False``: nothing of what
    they do asks the model or its data for a shape, camera or light. A subclass has to say so again. They are compared
    over a few control steps all the same; unless they agree to the bit, ``dynamics`` come back as they are. What an
    environment changes in its model reaches the copy by :func:`refresh`, as long as it :func:`still_serves`.

    Args:
        dynamics: the environment's.
        spec: what their model was compiled from; without it, or before MuJoCo 3.3.4, which first lets a
            specification delete shapes, they are returned as they are.
        n_actions: A.
    """
    model = dynamics.model
    if (
        spec is None
        or vars(type(dynamics)).get("reads_shapes", True)
        or not hasattr(spec, "delete")
        or any(getattr(model, count, 0) for count in REFERRING)
        or model.geom_fluid.any()
    ):
        return dynamics
    planned: Any = copy.copy(dynamics)
    try:
        planned.model, kept = _without_decoration(spec.copy(), model)
        planned.decoration = Decoration(model, planned.model, kept)
        refresh(planned)
        agree = np.array_equal(_few_steps(planned, n_actions), _few_steps(dynamics, n_actions))
    except (ValueError, IndexError, KeyError):  # MuJoCo cannot compile it, or the task looks for what is gone
        return dynamics
    return planned if agree else dynamics


@dataclass(frozen=True)
class Decoration:
    """How a lean model came about.

    Attributes:
        whole: the environment's model.
        stripped: the lean one.
        kept: the geoms of the one that are in the other.
    """

    whole: mujoco.MjModel
    stripped: mujoco.MjModel
    kept: np.ndarray


def refresh(dynamics: Dynamics) -> None:
    """Copy to a lean model what its environment has changed in the whole one; nothing to do for other dynamics."""
    decoration: Decoration | None = getattr(dynamics, "decoration", None)
    if decoration is None or decoration.stripped is not dynamics.model:  # a coarse copy keeps what it was made of
        return
    whole, stripped = decoration.whole, decoration.stripped
    for part in ("opt", "stat"):
        for name in dir(getattr(whole, part)):
            value = getattr(getattr(whole, part), name)
            if not name.startswith("_") and not callable(value):
                setattr(getattr(stripped, part), name, value)
    for name in dir(whole):
        values, own = getattr(whole, name), getattr(stripped, name)
        if isinstance(values, np.ndarray) and not name.startswith(OWN):
            values = values[decoration.kept] if name.startswith("geom_") else values
            if values.shape == own.shape:
                own[...] = values


def still_serves(dynamics: Dynamics) -> bool:
    """Whether what an environment has changed in the whole model can reach a lean one: no decoration became solid."""
    decoration: Decoration | None = getattr(dynamics, "decoration", None)
    if decoration is None or decoration.stripped is not dynamics.model:
        return False
    whole = decoration.whole
    return np.array_equal(_solid(whole), decoration.kept) and not whole.geom_fluid.any()


def _solid(model: mujoco.MjModel) -> np.ndarray:
    return np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))


def _without_decoration(spec: Any, model: mujoco.MjModel) -> tuple[mujoco.MjModel, np.ndarray]:
    """The model of what collides, and its geoms' numbers in ``model``."""
    kept = _solid(model)
    shown = [geom for geom in spec.geoms if geom.id not in kept]
    for body in spec.bodies:
        i, body.explicitinertial, body.fullinertia = body.id, True, np.full(6, np.nan)  # visual geoms may have mass
        body.mass, body.inertia = model.body_mass[i], model.body_inertia[i]
        body.ipos, body.iquat = model.body_ipos[i], model.body_iquat[i]
    for element in (*spec.cameras, *spec.lights, *shown):
        spec.delete(element)
    return spec.compile(), kept


def _few_steps(dynamics: Dynamics, n_actions: int) -> np.ndarray:
    data = mujoco.MjData(dynamics.model)
    mujoco.mj_forward(dynamics.model, data)
    state = np.empty(mujoco.mj_stateSize(dynamics.model, INTEGRATION_STATE))
    mujoco.mj_getState(dynamics.model, data, state, INTEGRATION_STATE)
    simulation, features = dynamics.bind(data), np.zeros((N_COMPARED, dynamics.n_features))
    simulation.restore(state)
    simulation.advance(dynamics.control(np.full((N_COMPARED, n_actions), 0.3, np.float32)), features)
    return features
