"""What the try before a session finds: plans that do not come true, and what it could not see."""

import warnings

import mujoco
import pytest
from test_changing_worlds import Pushed, Reacting, World

from mpc.rollout import RolloutEngine
from mpc.verify import verify
from mpc.workers import CAN_FORK
from napsp.envs.open_loop import OpenLoopSimulation


class Tired(OpenLoopSimulation):
    """Its strength is no part of the state."""

    def __init__(self, dynamics, data):
        super().__init__(dynamics, data)
        self.strength = 1.0

    def advance(self, controls, features):
        for control, row in zip(controls, features, strict=True):
            super().advance(self.strength * control[None], row[None])
            self.strength *= 0.9


class Meddling(OpenLoopSimulation):
    """Moves the wall, which all simulations share."""

    def advance(self, controls, features):
        self._model.geom_pos[0, 0] += 1e-6
        super().advance(controls, features)


class Windy(OpenLoopSimulation):
    """Blows between the physics steps, which one mujoco.rollout call leaves out."""

    def advance(self, controls, features):
        self._data.qvel[1] += 0.01
        super().advance(controls, features)


def kind(simulation, open_loop=False):
    def bind(self, data):
        return simulation(self, data)

    return type("Kind", (Reacting,), {"bind": bind, "open_loop": open_loop})


def trial(kind, n_threads=2, fork=False):
    world = World(kind)
    with RolloutEngine(world.dynamics, n_threads, fork) as engine:
        return verify(world, engine, "task")


@pytest.mark.parametrize(("n_threads", "fork"), [(1, False), (2, False), (2, CAN_FORK)])
@pytest.mark.parametrize("kind", [Pushed, Reacting])
def test_a_task_that_keeps_its_state_in_the_simulator_passes_without_a_word(kind, n_threads, fork):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = trial(kind, n_threads, fork)
    assert found.difference is None and found.touched and found.n_steps == 24
    word = (
        "mujoco.rollout" if kind is Pushed else "one thread" if n_threads == 1 else "processes" if fork else "threads"
    )
    assert word in found.path and f"24 steps of 2 episodes came as planned, to the bit ({found.path})" in str(found)


@pytest.mark.parametrize(("simulation", "open_loop"), [(Tired, False), (Windy, True)])
def test_plans_that_do_not_come_true_are_warned_of(simulation, open_loop):
    with pytest.warns(
        RuntimeWarning, match=r"task: a planned step differs from step\(\) .*observation, step 1 of plan"
    ):
        found = trial(kind(simulation, open_loop))
    assert found.difference.startswith("observation, step")
    assert str(found).startswith(f"only {found.n_steps} steps came as planned, the next one did not: observation, step")


def test_a_simulation_that_changes_the_model_is_warned_of():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        trial(kind(Meddling))
    assert any("planning changes the environment's model" in str(warning.message) for warning in caught)


def test_what_was_not_seen_is_said(monkeypatch):
    world = World()
    world.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    with RolloutEngine(world.dynamics, 1) as engine:
        found = verify(world, engine, "task")
    assert not found.touched and str(found).endswith("without contact, so contacts are unproven")


def test_a_task_that_ends_its_episodes_is_tried_up_to_there():
    class Ending(World):
        n_taken = 0

        def reset(self, **options):
            self.n_taken = 0
            return super().reset(**options)

        def step(self, action):
            assert self.n_taken < 3, "a step after the end"
            self.n_taken += 1
            observation, reward, _, truncated, info = super().step(action)
            return observation, reward, self.n_taken == 3, truncated, info

    world = Ending()
    with RolloutEngine(world.dynamics, 1) as engine:
        assert verify(world, engine, "task").n_steps == 6
