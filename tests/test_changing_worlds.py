"""Tasks that change at a reset, or in the middle of an episode: plans are made in what is there now."""

import mujoco
import numpy as np
import pytest

from mpc.rollout import RolloutEngine
from mpc.workers import CAN_FORK
from napsp.envs.dynamics import get_state
from napsp.envs.open_loop import OpenLoopDynamics, OpenLoopEnv
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session


def spec(x=0.3):
    return mujoco.MjSpec.from_string(f"""
    <mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody>
      <geom name="wall" type="box" size=".02 .3 .1" pos="{x} 0 0"/>
      <body name="ghost" pos=".15 0 0">
        <geom name="ghost" type="box" size=".02 .3 .1" contype="0" conaffinity="0"/></body>
      <body name="p"><joint name="x" type="slide" axis="1 0 0" damping="5"/>
        <joint name="y" type="slide" axis="0 1 0" damping="5"/><geom type="sphere" size=".05" mass="1"/></body>
    </worldbody><actuator><motor joint="x" gear="10" ctrlrange="-1 1"/><motor joint="y" gear="10" ctrlrange="-1 1"/>
    </actuator></mujoco>""")


class Pushed(OpenLoopDynamics):
    substeps, reads_shapes = 10, False
    share = 1.0

    def control(self, actions):
        return self.share * np.clip(np.asarray(actions, np.float64), -1, 1)

    def observe(self, features):
        return features, features[..., :2]


class Reacting(Pushed):
    """The same in workers, where it may be a copy."""

    open_loop, reads_shapes = False, False


class World(OpenLoopEnv):
    """A point, a wall, and a shape without substance; ``change(world, rng)`` is what a reset does to them."""

    max_episode_steps, step_length = 8, 0.1

    def __init__(self, kind=Pushed, change=lambda world, rng: None, render_mode=None):
        self.change, self.model_spec = change, spec()
        super().__init__(kind(spec().compile()), 0.05, render_mode)

    def _start(self):
        self.change(self, self.np_random)
        mujoco.mj_resetData(self.model, self.data)
        self.goal = np.array([1.0, 0.0])

    def goal_positions(self, goals):
        return np.concatenate([goals, np.zeros((*goals.shape[:-1], 1))], -1)


def arrays(world, rng):
    model = world.model
    model.geom("wall").pos[0] = rng.uniform(0.2, 0.8)
    model.body_mass[-1], model.actuator_gear[0, 0] = rng.uniform(0.5, 2.0), rng.uniform(5, 15)


def timestep(world, rng):
    world.model.opt.timestep = rng.choice([0.004, 0.005, 0.02])


def ghost(world, rng):
    model, solid = world.model, rng.integers(2)
    shape, body = model.geom("ghost").id, model.body("ghost").id
    model.geom_contype[shape] = model.geom_conaffinity[shape] = solid
    model.body_contype[body] = model.body_conaffinity[body] = solid  # MuJoCo's summary of a body's shapes


def attributes(world, rng):
    world.dynamics.share = rng.uniform(0.3, 1.0)


def compiled(world, rng):
    world.model_spec = spec(rng.uniform(0.2, 0.8))
    world.dynamics.model = world.model = world.model_spec.compile()
    world.data = mujoco.MjData(world.model)
    world._simulation = world.dynamics.bind(world.data)


def dynamics(world, rng):
    world.dynamics = type(world.dynamics)(world.dynamics.model)
    compiled(world, rng)


CHANGES = (arrays, timestep, ghost, attributes, compiled, dynamics)


@pytest.fixture
def session_in(monkeypatch):
    """Opens a session in a world of these classes."""
    opened = []

    def open_in(kind, change, model="exact", **settings):
        monkeypatch.setitem(globals(), "Task", lambda render_mode=None: World(kind, change, render_mode))
        config = {"env": "test_changing_worlds:Task", "cost": "euclidean", "search.samples": 6, "model.kind": model}
        opened.append(Session.open(PlanConfig.of("mppi", config | settings), RunOptions(threads=2)))
        return opened[-1]

    yield open_in
    for session in opened:
        session.close()


def forwards(n_steps=8):
    actions = np.zeros((4, n_steps, 2), np.float32)
    actions[..., 0] = 1.0
    return actions


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("kind", [Pushed, Reacting])
def test_plans_see_the_world_of_this_episode(session_in, kind, change):
    session = session_in(kind, change)
    assert session.verified.difference is None and session.verified.n_steps > 0
    world, ends = session.env.unwrapped, set()
    assert (session.controller.engine.dynamics.model is world.model) == (not hasattr(mujoco.MjSpec, "delete"))
    for seed in range(4):
        session.env.reset(seed=seed)
        session.controller.reset(np.random.default_rng(seed))
        planned = session.controller.engine.rollout(get_state(world.model, world.data), forwards())
        executed = np.array([session.env.step(action)[0]["achieved_goal"] for action in forwards()[0]])
        for path in planned.achieved_goals:
            np.testing.assert_array_equal(path, executed)
        assert not planned.diverged.any()
        ends.add(executed[-1, 0])
    assert len(ends) > 1, "the change does nothing"
    session.run_episode(0)


@pytest.mark.parametrize("change", [arrays, ghost, attributes])
@pytest.mark.parametrize("kind", [Pushed, Reacting])
def test_what_changes_inside_an_episode_reaches_the_next_plan(session_in, kind, change):
    session = session_in(kind, lambda world, rng: None)
    world, rng, ends = session.env.unwrapped, np.random.default_rng(3), set()
    session.env.reset(seed=0)
    for _ in range(3):
        change(world, rng)
        state = get_state(world.model, world.data)
        planned = session.controller.engine.rollout(state, forwards(2)).achieved_goals
        executed = np.array([world.step(action)[0]["achieved_goal"] for action in forwards(2)[0]])
        np.testing.assert_array_equal(planned, np.stack([executed] * 4))
        ends.add(executed[-1, 0])
    assert len(ends) == 3


def test_coarse_copies_keep_up(session_in):
    session = session_in(Reacting, arrays, "coarse", **{"model.substeps": 5})
    world, engine = session.env.unwrapped, session.controller.engine
    for seed in range(2):
        session.env.reset(seed=seed)
        engine.rollout(get_state(world.model, world.data), forwards())
        planned = engine.dynamics.model
        np.testing.assert_array_equal(planned.body_mass, world.model.body_mass)
        assert planned.opt.timestep == 2 * world.model.opt.timestep


@pytest.mark.parametrize("fork", [False, CAN_FORK])
def test_an_engine_alone_follows_a_task_that_makes_new_dynamics(fork):
    world = World(Reacting, dynamics)
    with RolloutEngine(world.dynamics, 2, fork, source=lambda: world.dynamics) as engine:
        for seed in range(2):
            world.reset(seed=seed)
            planned = engine.rollout(get_state(world.model, world.data), forwards()).achieved_goals[0]
            executed = np.array([world.step(action)[0]["achieved_goal"] for action in forwards()[0]])
            np.testing.assert_array_equal(planned, executed)
