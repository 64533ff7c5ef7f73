"""Planning models without decoration: fewer shapes, the same physics. tests/test_rollout.py runs them against step."""

import copy

import numpy as np
import pytest
from conftest import TASKS
from test_rollout import compare, planned_in, start_episode

from mpc.rollout import RolloutEngine
from napsp.envs.coarse import coarse
from napsp.envs.fetch import FetchReachWallEnv
from napsp.envs.lean import lean, refresh
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session


@pytest.mark.parametrize("name", TASKS)
def test_only_what_collides_is_left_and_all_else_is_the_same(name, worlds):
    world = worlds[name]
    own, planned = world.model, planned_in(world).model
    assert own.ncam > 0 and planned.ncam == planned.nlight == 0, "the environment keeps its cameras"
    collides = (own.geom_contype != 0) | (own.geom_conaffinity != 0)
    assert planned.ngeom == collides.sum() < own.ngeom
    for column in ("type", "size", "pos", "quat", "contype", "conaffinity", "condim", "friction", "bodyid", "solref"):
        np.testing.assert_array_equal(getattr(planned, f"geom_{column}"), getattr(own, f"geom_{column}")[collides])
    for column in ("nq", "nv", "nu", "nbody", "neq", "nmocap", "nexclude", "nkey"):
        assert getattr(planned, column) == getattr(own, column)


CHANGES = {
    "wall": lambda model: model.geom_size.__setitem__((model.geom("wall").id, 2), 0.05),
    "damping": lambda model: model.dof_damping.__iadd__(1.0),
    "springs": lambda model: (model.jnt_stiffness.__iadd__(50.0), model.qpos_spring.__iadd__(0.2)),
    "masses": lambda model: (model.body_mass.__imul__(2.0), model.body_inertia.__imul__(2.0)),
    "gravity": lambda model: model.opt.gravity.__setitem__(2, -5.0),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_an_environment_changes_later_reaches_the_plans(change):
    world = FetchReachWallEnv()
    with RolloutEngine(planned_in(world), 1) as engine:
        start_episode(world, 0, True)
        CHANGES[change](world.model)
        assert compare(world, engine, start_episode(world, 1, True)) > 0.0, "the change does nothing"
        actions = start_episode(world, 1, True)
        refresh(engine.dynamics)
        engine.reset()
        assert compare(world, engine, actions) == 0.0
    world.close()


def test_an_episode_begins_with_the_models_in_step():
    config = PlanConfig.of("mppi", {"env": "fetch_reach", "cost": "euclidean", "search.samples": 3})
    session = Session.open(config, RunOptions(threads=1))
    world, planned = session.env.unwrapped, session.controller.engine.dynamics.model
    assert planned.ngeom < world.model.ngeom and world.dynamics.model is world.model
    world.model.dof_damping += 1.0
    session.run_episode(0)
    np.testing.assert_array_equal(planned.dof_damping, world.model.dof_damping)
    session.close()


def test_a_coarse_copy_keeps_its_time_step(worlds):
    planned = coarse(planned_in(worlds["fetch_reach"]), 5)
    before = planned.model.opt.timestep
    refresh(planned)
    assert planned.model.opt.timestep == before == 4 * worlds["fetch_reach"].model.opt.timestep


def test_dynamics_that_refer_to_shapes_by_number_plan_in_the_whole_model(worlds):
    whole = worlds["fetch_reach"].dynamics

    class ByNumber(type(whole)):
        def bind(self, data):
            simulation = super().bind(data)
            simulation._recorded = (data.geom_xpos[self.model.ngeom // 2 + 4], *simulation._recorded[1:])
            return simulation

    dynamics = copy.copy(whole)
    dynamics.__class__ = ByNumber
    assert lean(dynamics, worlds["fetch_reach"].model_spec, 4) is dynamics
    assert lean(whole, worlds["fetch_reach"].model_spec, 4) is not whole
    assert lean(whole, None, 4) is whole
