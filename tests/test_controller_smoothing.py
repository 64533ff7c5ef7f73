"""What the receding-horizon loop hands out: the plan of its search, or what a smoother makes of it."""

from types import SimpleNamespace

import numpy as np
import pytest
from recording import (
    OBSERVATION,
    PLAN,
    STATE,
    TRIED,
    Line,
    calls,
    controller_of,
    far,
    names,
    plan,
    reached,
    recorded,
    search,
)

from mpc.controller import Plan, Smoothed
from mpc.cost import Cost
from planners.smooth import Held

# -- what comes out --


def test_a_plan_is_what_the_search_executes_after_its_last_round():
    tried = [TRIED[0], [[[-1.0], [-1.0], [-1.0]], [[-1.0], [-1.0], [-0.5]]]]
    controller, log = recorded(tried, n_refinements=2)
    planned = plan(controller)
    np.testing.assert_array_equal(planned.actions, np.float32(PLAN))
    np.testing.assert_array_equal(planned.action, np.float32([0.1]))
    assert planned.actions.dtype == np.float32
    assert planned.costs is calls(log, "update")[-1][1]
    np.testing.assert_allclose(planned.trajectories.observations[:, -1, 0], [2.0, 2.5])  # the second round's
    assert planned.effective_samples == 2.0, "after both rounds"
    assert planned.smoothing_ms >= 0.0


def test_a_held_plan_is_executed_action_by_action():
    planner = search(Held, 4, 1)
    planner.adopt(np.array([[0.1], [0.2], [0.3], [0.4]]))
    controller = controller_of(Line([]), planner, Cost(far, reached, "terminal"), 4)
    executed = [float(plan(controller).action[0]) for _ in range(6)]
    np.testing.assert_allclose(executed, [0.1, 0.2, 0.3, 0.4, 0.4, 0.4], rtol=1e-6)


def test_times_are_those_of_the_whole_call_and_of_smoothing(monkeypatch):
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr("mpc.controller.time.perf_counter", lambda: clock.now)

    def lasting(seconds, function):
        def call(*given):
            clock.now += seconds
            return function(*given)

        return call

    controller, _ = recorded(n_refinements=2, answers=[Smoothed(np.zeros((3, 1), np.float32), 1.0, True)])
    controller.engine.rollout = lasting(2.0, controller.engine.rollout)
    controller.smoother = lasting(3.0, controller.smoother)
    planned = plan(controller)
    assert (planned.milliseconds, planned.smoothing_ms) == (7000.0, 3000.0)


def test_the_cheapest_samples_are_in_order_without_those_that_diverged():
    planned = Plan(np.zeros(1), np.zeros((1, 1)), None, np.array([3.0, np.inf, 1.0, np.nan, 2.0]), 1.0, 0.0)
    assert planned.cheapest(2).tolist() == [2, 4] and planned.cheapest(9).tolist() == [2, 4, 0]
    assert planned.smoothing_ms == 0.0


@pytest.mark.parametrize("diverged", [True, False])
def test_a_lost_search_is_warned_of_once_with_its_reason(diverged):
    controller, _ = recorded()
    controller.engine.diverged = diverged
    controller.cost = Cost(lambda *rows: np.full(len(rows[0]), np.nan), reached, "terminal")
    reason = "every sampled plan diverged" if diverged else "the cost of every sampled plan is not finite"
    with pytest.warns(RuntimeWarning, match=f"^{reason}; keeping the previous plan$") as caught:
        for _ in range(2):
            planned = plan(controller)
    assert len(caught) == 1 and np.isinf(planned.costs).all()
    np.testing.assert_array_equal(planned.actions, np.float32(PLAN))


def test_a_search_lost_for_several_reasons_has_not_diverged_as_a_whole():
    controller, _ = recorded()
    controller.engine.diverged = [True, False]
    controller.cost = Cost(lambda *rows: np.full(len(rows[0]), np.nan), reached, "terminal")
    with pytest.warns(RuntimeWarning, match="^the cost of every sampled plan is not finite"):
        plan(controller)


def test_some_samples_without_a_cost_are_nothing_to_warn_of():
    controller, _ = recorded()
    controller.cost = Cost(lambda *rows: np.array([np.nan, 4.0]), reached, "terminal")
    np.testing.assert_array_equal(plan(controller).costs, [np.inf, 7.0])


# -- smoothing --

SMOOTH = np.array([[0.0], [0.9], [0.0]], np.float32)


def test_a_smoother_is_handed_the_plan_of_the_search_and_its_answer_is_executed():
    controller, log = recorded(answers=[Smoothed(SMOOTH, 2.0, True)])
    planned = plan(controller)
    assert names(log) == ["sample", "rollout", "update", "smooth", "adopt"]
    state, observation, actions, executed = calls(log, "smooth")[0]
    assert state is STATE and observation["observation"] is OBSERVATION["observation"]
    np.testing.assert_array_equal(actions, np.float32(PLAN))
    assert executed.shape == (0, 1) and executed.dtype == np.float32
    np.testing.assert_array_equal(planned.actions, SMOOTH)
    np.testing.assert_array_equal(planned.action, SMOOTH[0])


@pytest.mark.parametrize(("cost", "accepted"), [(2.0, True), (0.0, True), (None, True), (2.0, False), (None, False)])
def test_only_an_accepted_plan_that_was_rolled_out_is_adopted(cost, accepted):
    controller, log = recorded(
        [[[[0.0], [1.0]]]], [[0.0], [1.0]], n_knots=2, answers=[Smoothed(SMOOTH, cost, accepted)]
    )
    planned = plan(controller)
    adopted = calls(log, "adopt")
    assert len(adopted) == (accepted and cost is not None)
    for (knots,) in adopted:
        np.testing.assert_allclose(knots, [[0.3], [0.3]], atol=1e-7)  # the nearest that two knots can say
    np.testing.assert_array_equal(planned.actions, SMOOTH)


def test_a_smoother_sees_the_last_two_actions_the_latest_last():
    rows = np.array([[0.1, 0.2, 0.3, 0.4], [0.5, 0.5, 0.5, 0.5], [0.6, 0.6, 0.6, 0.6]], np.float32)
    answers = [Smoothed(row[:, None].copy(), 1.0, accepted) for row, accepted in zip(rows.T, (1, 0, 1, 1), strict=True)]
    controller, log = recorded(answers=list(answers))
    for answer in answers:
        plan(controller)
        answer.actions[:] = 9.0  # whoever owns the plan may write into it
    seen = [executed[:, 0] for _, _, _, executed in calls(log, "smooth")]
    for found, expected in zip(seen, ([], [0.1], [0.1, 0.2], [0.2, 0.3]), strict=True):
        np.testing.assert_array_equal(found, np.float32(expected))


def test_a_smoother_is_told_what_was_really_executed_and_how_many_steps_went_by():
    controller, log = recorded(answers=[Smoothed(SMOOTH, 1.0, True), Smoothed(SMOOTH, 1.0, False)])
    plan(controller)
    controller.skip(2)
    controller.plan_from(STATE, OBSERVATION, np.float32([[0.5], [0.9]]))
    assert calls(log, "smoother.skip") == [(2,)]
    assert [executed.tolist() for *_, executed in calls(log, "smooth")] == [[], np.float32([[0.5], [0.9]]).tolist()]
