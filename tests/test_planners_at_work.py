"""Search algorithms at work: in the receding-horizon loop, with the fewest samples, in a session."""

import copy
import dataclasses

import mujoco
import numpy as np
import pytest
from explosive import Explosive
from searches import SAMPLING as ALL
from searches import search as make

from mpc.controller import Controller, Smoothed
from mpc.cost import Cost, EuclideanSteps
from mpc.rollout import RolloutEngine
from napsp.envs.dynamics import get_state
from napsp.errors import UserError
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.searches import SEARCHES
from planners.app.session import Session
from planners.mppi import MPPI


@pytest.mark.parametrize("open_loop", [True, False])
@pytest.mark.parametrize("kind", ALL)
def test_a_proposal_of_nan_is_left_out_with_one_warning(kind, open_loop):
    dynamics = Explosive(open_loop)
    dynamics.model.actuator_gear[:] = 1e-4  # gentle: nothing but the proposal goes wrong
    state = get_state(dynamics.model, mujoco.MjData(dynamics.model))
    observation = {"observation": np.zeros(2), "achieved_goal": np.zeros(2), "desired_goal": np.zeros(2)}
    with RolloutEngine(dynamics, n_threads=1) as engine:
        cost = Cost(EuclideanSteps(1.0), lambda achieved, goal: np.zeros(achieved.shape[:-1], bool))
        controller = Controller(
            engine, make(kind, 3, 1, samples=8), cost, 3, np.random.default_rng(0),
            proposals_from=[lambda observations, goals: np.full((1, 1), np.nan, np.float32)],
        )  # fmt: skip
        with pytest.warns(RuntimeWarning, match="not finite; left out") as caught:
            plans = [controller.plan_from(state, observation) for _ in range(3)]
    assert len(caught) == 1 and all(np.isfinite(plan.actions).all() for plan in plans)


def test_the_search_goes_on_from_a_smoothed_plan_that_was_rolled_out(worlds):
    world, observation = worlds["point_maze"].unwrapped, worlds["point_maze"].reset(seed=0)[0]
    smooth = np.linspace(-0.5, 0.5, 8, dtype=np.float32).reshape(4, 2)

    class Given:
        cost: float | None = 3.0

        def reset(self):
            """Nothing is remembered."""

        def __call__(self, state, observation, actions, executed):
            return Smoothed(smooth, self.cost, True)

    with RolloutEngine(world.dynamics, n_threads=1) as engine:
        planner, smoother = make(MPPI, 4, 2, samples=8), Given()
        cost = Cost(EuclideanSteps(1.0), world.reached)
        controller = Controller(engine, planner, cost, 4, np.random.default_rng(0), smoother=smoother)
        controller.plan(world, observation)
        np.testing.assert_allclose(planner.plan, smooth, atol=1e-6)
        smoother.cost = None  # nobody knows what it costs: executed, but no start for the search
        planned = controller.plan(world, observation)
    np.testing.assert_array_equal(planned.actions, smooth)
    assert not np.allclose(planner.plan, smooth, atol=1e-3)


@pytest.mark.parametrize("name", ["mppi", "cem", "icem", "predictive_sampling"])
@pytest.mark.parametrize("refinements", [1, 2])
def test_the_least_number_of_samples_is_the_one_that_leaves_room_for_noise(name, refinements):
    few = {"elites": 2} if name in ("cem", "icem") else {}
    search = SEARCHES[name].config(refinements=refinements, **few)
    least = search.least_samples(1)  # the policy's rollout
    with pytest.raises(UserError, match=f"give at least {least}"):
        PlanConfig("mppi", dataclasses.replace(search, samples=least - 1))

    def fewest_noisy(n_samples):
        planner = SEARCHES[name].kind(3, 2, dataclasses.replace(search, samples=n_samples))
        rng, proposals, found = np.random.default_rng(0), np.full((1, 3, 2), 0.5), []
        for _ in range(3):
            for _ in range(refinements):
                knots = copy.deepcopy(planner).sample(np.random.default_rng(1), proposals)
                other = planner.sample(rng, proposals)
                found.append(int((knots != other).any((1, 2)).sum()))
                planner.update(other, rng.random(len(other)))
            planner.shift(np.eye(3))
        return min(found)

    assert fewest_noisy(least) == 1 and fewest_noisy(least - 1) == 0


def test_planning_and_environment_draw_from_different_streams(monkeypatch):
    drawn = []
    config = PlanConfig.of("mppi", {"env": "point_maze", "cost": "euclidean", "search.samples": 4})
    session = Session.open(config, RunOptions(threads=1))
    monkeypatch.setattr("napsp.envs.episode_length", lambda name: 0)
    monkeypatch.setattr(session.controller, "reset", lambda rng: drawn.append(rng.random(4)))
    monkeypatch.setattr("planners.app.session.EpisodeResult", lambda *parts: None)
    session.run_episode(7)
    session.close()
    assert not np.array_equal(drawn[0], np.random.default_rng(7).random(4))
