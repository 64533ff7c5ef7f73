"""Planning models without decoration: fewer shapes, the same physics. tests/test_rollout.py runs them against step."""

import numpy as np
import pytest
from conftest import TASKS

from napsp.envs.lean import lean
from planners.options import MPPIOptions
from planners.session import Session

SHAPES = ("body_geomadr", "body_geomnum")


@pytest.mark.parametrize("name", TASKS)
def test_only_what_collides_is_left_and_all_else_is_the_same(name, worlds):
    world = worlds[name]
    own, planned = world.model, lean(world.dynamics, world.model_spec).model
    assert own.ncam > 0 and planned.ncam == planned.nlight == 0, "the environment keeps its cameras"
    collides = (own.geom_contype != 0) | (own.geom_conaffinity != 0)
    assert planned.ngeom == collides.sum() < own.ngeom
    for column in ("type", "size", "pos", "quat", "contype", "conaffinity", "condim", "friction", "bodyid", "solref"):
        np.testing.assert_array_equal(getattr(planned, f"geom_{column}"), getattr(own, f"geom_{column}")[collides])
    for column in dir(own):
        values = getattr(own, column)
        if column.startswith(("body_", "jnt_", "dof_", "eq_", "actuator_")) and column not in SHAPES:
            np.testing.assert_array_equal(getattr(planned, column), values, err_msg=column)


def test_what_an_environment_changed_after_compiling_is_kept(worlds):
    world = worlds["fetch_wall"]
    damping, timestep = world.model.dof_damping.copy(), world.model.opt.timestep
    wall = world.model.geom("wall").id
    width = world.model.geom_size[wall, 0]
    try:
        world.model.dof_damping += 1.0
        world.model.geom_size[wall, 0] = 0.5 * width
        world.model.opt.timestep = 0.001
        planned = lean(world.dynamics, world.model_spec).model
    finally:
        world.model.dof_damping[:], world.model.opt.timestep = damping, timestep
        world.model.geom_size[wall, 0] = width
    np.testing.assert_array_equal(planned.dof_damping, damping + 1.0)
    assert planned.opt.timestep == 0.001 and planned.geom("wall").size[0] == 0.5 * width


def test_planners_simulate_it_and_environments_do_not():
    session = Session.open("mppi", MPPIOptions(env="fetch_reach", cost="euclidean", threads=1))
    world, planned = session.env.unwrapped, session.controller.engine.dynamics
    assert planned.model.ngeom < world.model.ngeom and world.dynamics.model is world.model
    session.close()


def test_without_a_specification_nothing_is_left_out(worlds):
    dynamics = worlds["claw"].dynamics
    assert lean(dynamics, None) is dynamics
