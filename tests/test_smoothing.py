"""The smoothing layer: never a worse plan, and the same episodes around it."""

import dataclasses
import subprocess
import sys

import casadi
import numpy as np
import pytest
from test_smoothing_distance import shipped

from mpc.controller import Controller
from mpc.cost import Cost, LearnedSteps
from mpc.motion import action_rate
from mpc.rollout import RolloutEngine
from mpc.smoothing.layer import Smoother, SmoothingConfig
from mpc.smoothing.problem import SOLVERS, SolverError
from napsp.envs.dynamics import get_state
from napsp.errors import UserError
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session
from planners.mppi import MPPI, MPPIConfig
from planners.smooth import Held, HeldConfig


def maze(worlds, seed=1, horizon=8, to_go=None, config=None, where="mean", action_of="policy"):
    world, model = worlds["point_maze"], shipped("point_maze")
    observation, _ = world.reset(seed=seed)
    engine = RolloutEngine(world.dynamics, 1)
    cost = Cost(to_go or LearnedSteps(model), world.reached, where, action_of)
    return world, observation, Smoother(engine, cost, model, horizon, 2, config)


def test_of_several_weights_the_smoothest_answer_that_costs_no_more_is_taken(worlds):
    actions = np.random.default_rng(2).uniform(-1, 1, (8, 2)).astype(np.float32)
    executed, rates = np.zeros((2, 2), np.float32), {}
    for multiples in ((1.0,), (0.3, 1.0, 3.0, 10.0)):
        world, observation, smoother = maze(worlds, config=SmoothingConfig(multiples=multiples, choice=10.0))
        result = smoother(get_state(world.model, world.data), observation, actions, executed)
        statistics = smoother.statistics
        assert result.accepted and statistics.after[0] <= statistics.before[0]
        rates[multiples] = action_rate(np.concatenate([executed[-1:], result.actions]))
        smoother.engine.close()
    few, many = rates.values()
    assert many < few < action_rate(np.concatenate([executed[-1:], actions]))


def test_answers_are_used_although_another_weight_has_none(worlds):
    world, observation, smoother = maze(worlds, config=SmoothingConfig(multiples=(1.0, 3.0), choice=10.0))
    solve, calls = smoother._solver.solve, []

    def fails_first(problem):
        calls.append(problem)
        if len(calls) == 1:
            raise SolverError("no answer")
        return solve(problem)

    smoother._solver.solve = fails_first
    actions = np.random.default_rng(2).uniform(-1, 1, (8, 2)).astype(np.float32)
    result = smoother(get_state(world.model, world.data), observation, actions, np.zeros((2, 2), np.float32))
    assert result.accepted and smoother.statistics.n_solver_failures == 1 and len(calls) == 2
    smoother.engine.close()


@pytest.mark.parametrize("action_of", ["policy", "plan"])
@pytest.mark.parametrize("where", ["mean", "terminal", "both"])
def test_smoothed_plans_are_smoother_never_worse_and_within_bounds(worlds, action_of, where):
    world, observation, smoother = maze(worlds, where=where, action_of=action_of)
    state, rng, goal = get_state(world.model, world.data), np.random.default_rng(0), observation["desired_goal"]
    n = smoother.cost.simulated_steps(8)
    for _ in range(15):
        actions = rng.uniform(-1.2, 1.2, (8, 2)).clip(-1, 1).astype(np.float32)
        executed = rng.uniform(-1, 1, (rng.integers(0, 3), 2)).astype(np.float32)
        smoother.reset()  # with a last plan to begin with, the trust region would be around that one
        smoother.trust = trust = rng.uniform(0.05, 0.8)
        result = smoother(state, observation, actions, executed)
        plans = np.stack([actions, result.actions])
        before, after = smoother.cost(observation, smoother.engine.rollout(state, plans[:, :n]), plans, goal)
        assert after <= before + 1e-4 and (np.abs(result.actions) <= 1.0).all()
        assert np.abs(result.actions - actions).max() <= trust + 1e-6
        if result.accepted:
            assert result.cost == pytest.approx(after, abs=1e-4)  # float32, in batches of another size
            rough, smooth = (action_rate(np.concatenate([executed[-1:], plan])) for plan in plans)
            assert smooth < rough
    statistics = smoother.statistics
    assert statistics.n_accepted >= 8 and statistics.n_risen == statistics.n_solver_failures == 0
    assert len(statistics.before) == len(statistics.solve_ms) == statistics.n_calls == 15
    smoother.engine.close()


def test_a_last_plan_that_costs_no_more_is_kept(worlds):
    world, observation, smoother = maze(worlds)
    state = get_state(world.model, world.data)
    observation["desired_goal"] = observation["achieved_goal"].copy()  # there already: standing still costs nothing
    executed, rng = np.zeros((2, 2), np.float32), np.random.default_rng(0)
    smoother(state, observation, np.zeros((8, 2), np.float32), executed)
    for _ in range(5):
        shaken = (0.05 * rng.standard_normal((8, 2))).astype(np.float32)
        result = smoother(state, observation, shaken, executed)
        assert result.accepted and result.cost == 0.0
        assert action_rate(result.actions) < 0.2 * action_rate(shaken)
    smoother.reset()
    assert smoother._last is None
    smoother.engine.close()


def test_plans_handed_back_are_counted_and_say_nothing_about_the_linear_model(worlds):
    world, observation, smoother = maze(worlds)
    state, executed = get_state(world.model, world.data), np.zeros((2, 2), np.float32)
    observation["desired_goal"] = observation["achieved_goal"].copy()
    still = np.zeros((8, 2), np.float32)
    for n_calls in (1, 2, 3):  # nothing can be smoother than standing still; it is not the layer's plan either
        assert not smoother(state, observation, still, executed).accepted
        assert smoother.statistics.n_kept == 0 and smoother.statistics.n_calls == n_calls
    assert smoother.trust == smoother.config.trust
    shaken = (0.05 * np.random.default_rng(0).standard_normal((8, 2))).astype(np.float32)
    result = smoother(state, observation, shaken, executed)
    assert result.accepted
    handed_back = np.concatenate([result.actions[1:], result.actions[-1:]])
    again = smoother(state, observation, handed_back, executed)  # made smoother once more, or left as it is
    smoother.config = dataclasses.replace(smoother.config, rounds=0)  # the layer changes nothing any more
    handed_back = np.concatenate([again.actions[1:], again.actions[-1:]])
    n_kept = smoother.statistics.n_kept
    assert not smoother(state, observation, handed_back, executed).accepted
    assert smoother.statistics.n_kept == n_kept + 1
    smoother.engine.close()


def test_a_model_that_lies_is_refused(worlds):
    # The true cost is the opposite of what the layer's model of it says: every move it likes makes it worse.
    learned = LearnedSteps(shipped("point_maze"))
    world, observation, smoother = maze(
        worlds, to_go=lambda *rows: 50.0 - learned(*rows), config=SmoothingConfig(rate=1e-4, distance=100.0)
    )
    actions = np.random.default_rng(0).uniform(-0.5, 0.5, (8, 2)).astype(np.float32)
    for _ in range(3):
        result = smoother(get_state(world.model, world.data), observation, actions, np.zeros((0, 2), np.float32))
        assert not result.accepted
        np.testing.assert_array_equal(result.actions, actions)
    assert smoother.statistics.n_accepted == 0 and smoother.trust < smoother.config.trust
    smoother.engine.close()


def test_numbers_that_are_not_finite_leave_the_plan_alone(worlds):
    actions, executed = np.random.default_rng(0).uniform(-0.5, 0.5, (8, 2)).astype(np.float32), np.zeros((1, 2))
    world, observation, smoother = maze(worlds, to_go=lambda *rows: np.full(len(rows[0]), np.nan))
    state = get_state(world.model, world.data)
    np.testing.assert_array_equal(smoother(state, observation, actions, executed).actions, actions)
    assert smoother.statistics.n_accepted == 0
    for solver in SOLVERS:
        world, observation, smoother = maze(worlds, config=SmoothingConfig(solver=solver))
        smoother.distance._members[0].layers[0][0][:] = np.nan  # d breaks inside the layer only
        smoother._solver = SOLVERS[solver](smoother.distance, 16, len(smoother._read))
        result = smoother(state, observation, actions, executed)
        np.testing.assert_array_equal(result.actions, actions)
        assert smoother.statistics.n_solver_failures == 1 and not result.accepted
        smoother.engine.close()


def controller(world, observation, smoother, planner=None, rng=0):
    planner = planner or MPPI(smoother.horizon, 2, MPPIConfig(samples=24))
    return Controller(
        smoother.engine, planner, smoother.cost, smoother.horizon, np.random.default_rng(rng), smoother=smoother
    )


def test_the_solver_is_built_once_and_the_world_is_left_alone(worlds, monkeypatch):
    world, observation, smoother = maze(worlds)
    for name in ("conic", "nlpsol"):
        monkeypatch.setattr(casadi, name, lambda *_: pytest.fail("built again"))
    control = controller(world, observation, smoother)
    before = get_state(world.model, world.data)
    for _ in range(4):
        plan = control.plan(world, observation)
        assert 0.0 < plan.smoothing_ms < plan.milliseconds
        np.testing.assert_array_equal(plan.action, plan.actions[0])
    np.testing.assert_array_equal(before, get_state(world.model, world.data))
    assert smoother.statistics.n_calls == 4
    control.reset()
    assert smoother.trust == smoother.config.trust
    smoother.engine.close()


def test_the_layer_alone_finds_the_way_from_zero(worlds):
    config = SmoothingConfig(accept="better", rounds=2)
    world, observation, smoother = maze(worlds, seed=1, horizon=16, config=config)
    control = controller(world, observation, smoother, Held(16, 2, HeldConfig("zero")))
    reached = False
    for _ in range(40):
        observation, _, _, _, info = world.step(control.plan(world, observation).action)
        reached |= info["is_success"]
    assert reached
    smoother.engine.close()


@pytest.mark.parametrize("config", [
    PlanConfig.of("mppi", {"env": "point_maze"}),
    PlanConfig.of("mppi", {"env": "point_maze", "smooth": True, "smooth.solver": "ipopt"}),
    PlanConfig.of("icem", {"env": "point_maze", "proposals": False}),
], ids=lambda config: config.planner)  # fmt: skip
def test_an_episode_is_the_same_alone_and_in_a_series(config, monkeypatch):
    monkeypatch.setattr("napsp.envs.episode_length", lambda name: 3)
    series, alone = Session.open(config, RunOptions(seed=4)), []
    episodes = [series.run_episode(seed) for seed in (4, 5, 6)]
    series.close()
    for seed in (6, 4):
        session = Session.open(config, RunOptions(seed=seed))
        alone.append(session.run_episode(seed).actions)
        session.close()
    np.testing.assert_array_equal(alone, [episodes[2].actions, episodes[0].actions])
    assert not np.array_equal(episodes[0].actions, episodes[1].actions)


def test_planning_without_smoothing_imports_no_casadi():
    code = "import sys, planners.app.session, planners.app.report, planners.smooth; assert 'casadi' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(("planner", "changes", "plans"), [
    ("smooth", {}, 2), ("smooth", {"distance.greedy_proposals": True}, 3), ("smooth", {"proposals": False}, 1),
    ("smooth", {"search.start": "zero"}, 1), ("icem", {"proposals": False}, 26 + 20 + 16),
])  # fmt: skip
def test_plans_that_are_tried_are_counted(planner, changes, plans):
    session = Session.open(PlanConfig.of(planner, {"env": "point_maze", **changes}))
    observation, _ = session.env.reset(seed=0)
    session.controller.plan(session.env.unwrapped, observation)
    assert session.controller.n_tried == plans
    session.close()


def test_unsaid_settings_of_the_layer_are_the_tasks():
    usual = SmoothingConfig()
    assert usual.resolved() == SmoothingConfig(multiples=(1.0,), choice=1.0)
    assert usual.resolved((0.3, 3.0)) == SmoothingConfig(multiples=(0.3, 3.0), choice=10.0)
    assert SmoothingConfig(choice=2.0, multiples=(5.0,)).resolved((0.3, 3.0)).choice == 2.0
    for wrong in ((), (0.0,), (1.0, float("nan"))):
        with pytest.raises(UserError, match="multiples is"):
            SmoothingConfig(multiples=wrong)
