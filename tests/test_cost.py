"""J of a plan, on trajectories written by hand."""

from dataclasses import replace

import numpy as np
import pytest

from mpc.cost import Cost
from mpc.rollout import Trajectories

GOAL = np.array([0.0])


def reached(achieved, goals):
    return np.abs(np.asarray(achieved) - goals)[..., 0] < 0.5


def trajectories(*paths, diverged=None):
    rows = np.array(paths, float)[..., None]
    flags = np.zeros(len(paths), bool) if diverged is None else np.array(diverged)
    return Trajectories(rows, rows, flags)


def steps_to_go(observations, achieved, actions, goal):
    """True steps at one metre per step, plus the action when it is given."""
    steps = np.abs(achieved - goal)[:, 0]
    return steps if actions is None else steps + 100.0 * actions[:, 0]


START = {"observation": np.array([5.0]), "achieved_goal": np.array([5.0]), "desired_goal": GOAL}
PATHS = trajectories([4, 3, 2], [2, 0, 0], [0, 1, 2])
ACTIONS = np.zeros((3, 3, 1))


def test_terminal_cost_is_steps_spent_plus_steps_left():
    cost = Cost(steps_to_go, reached, "terminal")
    # Never there: 3 spent + 2 left. There at step 2 and staying: 1. There at once, then leaving: 2.
    np.testing.assert_allclose(cost(START, PATHS, ACTIONS, GOAL), [5.0, 1.0, 2.0])


def test_mean_cost_averages_over_the_states_outside_the_goal():
    cost = Cost(steps_to_go, reached, "mean")
    expected = [3 + (4 + 3 + 2) / 3, 1 + 2 / 3, 2 + (1 + 2) / 3]
    np.testing.assert_allclose(cost(START, PATHS, ACTIONS, GOAL), expected)


def test_long_plans_average_evenly_spaced_states():
    cost = Cost(steps_to_go, reached, "mean", n_averaged=3)
    np.testing.assert_array_equal(cost._averaged(9), [2, 5, 8])
    np.testing.assert_array_equal(cost._averaged(3), [0, 1, 2])
    np.testing.assert_array_equal(cost._averaged(2), [0, 1])
    assert all(len(set(cost._averaged(n).tolist())) == min(n, 3) and cost._averaged(n).min() >= 0 for n in range(1, 40))
    path = trajectories([9, 8, 7, 6, 5, 4, 3, 2, 1])
    np.testing.assert_allclose(cost(START, path, np.zeros((1, 9, 1)), GOAL), [9 + (7 + 4 + 1) / 3])


def test_both_adds_the_two():
    cost = Cost(steps_to_go, reached, "both")
    np.testing.assert_allclose(cost(START, PATHS, ACTIONS, GOAL), [3 + 3 + 2, 1 + 2 / 3, 2 + 1])


def test_plan_action_uses_the_last_action_without_simulating_it():
    cost = Cost(steps_to_go, reached, "terminal", action_of="plan")
    assert cost.simulated_steps(3) == 2
    actions = np.zeros((1, 3, 1))
    actions[0, :, 0] = [0.5, 0.6, 0.1]
    # s_1 = 4, s_2 = 3 are simulated; d(s_2, a_2, g) = 3 + 100 * 0.1.
    np.testing.assert_allclose(cost(START, trajectories([4, 3]), actions, GOAL), [2 + 13])


def test_horizon_one_is_the_distance_itself():
    cost = Cost(steps_to_go, reached, "terminal", action_of="plan")
    actions = np.array([[[0.2]], [[-0.01]]])
    nothing = Trajectories(np.empty((2, 0, 1)), np.empty((2, 0, 1)), np.zeros(2, bool))
    np.testing.assert_allclose(cost(START, nothing, actions, GOAL), [25.0, 4.0])


def test_diverged_and_nan_cost_infinity():
    cost = Cost(steps_to_go, reached, "terminal")
    paths = trajectories([0, 0, 0], [np.nan, np.nan, np.nan], [4, 3, 2], diverged=[True, False, False])
    costs = cost(START, paths, ACTIONS, GOAL)
    assert np.isinf(costs[:2]).all() and np.isfinite(costs[2])


# d at s_0 is 5 and its own action adds 100 a; a_t = t / 100 makes 0, 1, 2 of it.
OWN = np.tile(np.array([0.0, 0.01, 0.02])[:, None], (3, 1, 1))
SHORT = trajectories([4, 3], [0, 3], [1, 0])  # s_1, s_2 of three actions
HAND = {
    # s_1 s_2 s_3 with the policy's action; nothing is to go at the end of what has been there: 1 + 0, 2 + 0.
    ("terminal", "policy"): [3 + 2, 1, 2],
    ("mean", "policy"): [3 + 9 / 3, 1 + 2 / 3, 2 + 3 / 3],
    ("both", "policy"): [3 + 9 / 3 + 2, 1 + 2 / 3, 2 + 3 / 3],
    # s_0 s_1 s_2 with the plan's actions: d is 5 + 0, 4 + 1, 3 + 2; then 5, -, 3 + 2; then 5, 1 + 1, -.
    ("terminal", "plan"): [2 + 5, 1, 1],
    ("mean", "plan"): [2 + 15 / 3, 1 + 10 / 3, 1 + 7 / 3],
    ("both", "plan"): [2 + 15 / 3 + 5, 1 + 10 / 3, 1 + 7 / 3],
}


@pytest.mark.parametrize(("where", "action_of"), HAND)
def test_costs_are_those_worked_out_by_hand(where, action_of):
    cost = Cost(steps_to_go, reached, where, action_of)
    paths = PATHS if action_of == "policy" else SHORT
    np.testing.assert_allclose(cost(START, paths, OWN, GOAL), HAND[where, action_of])


@pytest.mark.parametrize("where", ["terminal", "mean", "both"])
def test_a_plan_that_starts_at_the_goal_has_nothing_to_go_at_its_end(where):
    here = {**START, "observation": np.array([0.4]), "achieved_goal": np.array([0.4])}
    cost = Cost(steps_to_go, reached, where, "plan")
    # s_0 is there, s_1 and s_2 are not: two steps, and d along s_1 and s_2 of three states.
    along = 0.0 if where == "terminal" else (1 + 1 + 2 + 2) / 3
    np.testing.assert_allclose(cost(here, trajectories([1, 2]), OWN[:1], GOAL), [2 + along])


def test_the_goal_that_counts_is_the_one_that_is_asked_for():
    cost = Cost(steps_to_go, reached, "terminal", "plan")
    np.testing.assert_allclose(cost(START, trajectories([4, 3]), OWN[:1], np.array([4.0])), [1])
    np.testing.assert_allclose(cost(START, trajectories([4, 3]), OWN[:1], np.array([5.0])), [2])
    np.testing.assert_allclose(cost(START, trajectories([4, 3]), OWN[:1], np.array([1.0])), [2 + 2 + 2])


def test_d_is_asked_about_rows_of_one_state_each():
    asked = []

    def to_go(observations, achieved, actions, goal):
        asked.append((observations, achieved, actions, goal))
        return np.arange(float(len(achieved)))

    observations = np.arange(24.0).reshape(2, 3, 4) + 10
    paths = Trajectories(observations, observations[..., :2], np.zeros(2, bool))
    start = {"observation": np.arange(4.0), "achieved_goal": np.array([8.0, 9.0])}
    actions, goal = np.arange(18.0).reshape(2, 3, 3), np.array([-5.0, 0.0])
    costs = Cost(to_go, reached, "mean", n_averaged=2)(start, paths, actions, goal)
    rows, achieved, chosen, target = asked.pop()  # s_1 and s_3 of each: the average of 0, 1 and of 2, 3
    np.testing.assert_array_equal(rows, observations[:, [0, 2]].reshape(4, 4))
    np.testing.assert_array_equal(achieved, observations[:, [0, 2], :2].reshape(4, 2))
    assert chosen is None and target is goal
    np.testing.assert_allclose(costs, [3 + 0.5, 3 + 2.5])
    paths = replace(paths, observations=observations[:, :2], achieved_goals=observations[:, :2, :2])
    Cost(to_go, reached, "mean", "plan")(start, paths, actions, goal)
    rows, achieved, chosen, _ = asked.pop()
    expected = np.concatenate([np.tile(np.arange(4.0), (2, 1, 1)), observations[:, :2]], axis=1)
    np.testing.assert_array_equal(rows, expected.reshape(6, 4))
    np.testing.assert_array_equal(achieved.reshape(2, 3, 2)[:, 0], [[8.0, 9.0], [8.0, 9.0]])
    np.testing.assert_array_equal(achieved.reshape(2, 3, 2)[:, 1:], observations[:, :2, :2])
    np.testing.assert_array_equal(chosen, actions.reshape(6, 3))
    Cost(to_go, reached, "terminal", "plan")(start, paths, actions, goal)
    rows, achieved, chosen, _ = asked.pop()
    np.testing.assert_array_equal(rows, observations[:, 1])
    np.testing.assert_array_equal(achieved, observations[:, 1, :2])
    np.testing.assert_array_equal(chosen, actions[:, 2])


def test_the_success_test_is_asked_whether_achieved_goals_are_at_the_desired_one():
    def at_least(achieved, desired):
        assert achieved.shape == desired.shape
        return achieved[..., 0] >= desired[..., 0]

    goal = np.array([2.0])
    costs = Cost(steps_to_go, at_least, "terminal")(START, PATHS, ACTIONS, goal)
    np.testing.assert_allclose(costs, [0, 2, 2])
    costs = Cost(steps_to_go, at_least, "terminal", "plan")(
        {**START, "achieved_goal": np.array([1.0])}, SHORT, OWN, goal
    )
    np.testing.assert_allclose(costs, [0, 1, 2 + 2 + 2])


def test_unless_told_otherwise_d_is_averaged_over_eight_states_at_the_policys_action():
    assert Cost(steps_to_go, reached) == Cost(steps_to_go, reached, "mean", "policy", 8)


def test_numbers_of_steps_that_are_simulated():
    assert [Cost(steps_to_go, reached, action_of="policy").simulated_steps(n) for n in (1, 5)] == [1, 5]
    assert [Cost(steps_to_go, reached, action_of="plan").simulated_steps(n) for n in (1, 5)] == [0, 4]


@pytest.mark.parametrize(
    ("n_averaged", "n_states", "read"),
    [
        (3, 4, [0, 2, 3]),  # every 4 / 3 back from the last: 3, 1.67, 0.33
        (3, 5, [1, 2, 4]),
        (2, 7, [2, 6]),  # 3.5 rounds to the even
        (1, 7, [6]),
        (4, 4, [0, 1, 2, 3]),
        (8, 50, [5, 11, 18, 24, 30, 37, 43, 49]),
        (8, 3, [0, 1, 2]),
    ],
)
def test_the_average_reads_evenly_spaced_states_back_from_the_last(n_averaged, n_states, read):
    cost = Cost(steps_to_go, reached, "mean", n_averaged=n_averaged)
    np.testing.assert_array_equal(cost._averaged(n_states), read)


def test_weights_are_those_of_the_states_that_are_read():
    weights = {
        where: Cost(steps_to_go, reached, where, n_averaged=2).weights(4) for where in ("terminal", "mean", "both")
    }
    np.testing.assert_array_equal(weights["terminal"], [0, 0, 0, 1])
    np.testing.assert_array_equal(weights["mean"], [0, 0.5, 0, 0.5])
    np.testing.assert_array_equal(weights["both"], [0, 0.5, 0, 1.5])


@pytest.mark.parametrize(("where", "action_of"), HAND)
@pytest.mark.parametrize("n_averaged", [3, 8])
def test_outside_the_goal_the_cost_is_steps_plus_weighted_d(where, action_of, n_averaged):
    read = np.random.default_rng(0).uniform(1.0, 9.0, (4, 6))  # s_1 .. s_6, or s_0 .. s_5 from one start
    if action_of == "plan":
        read[:, 0] = 5.0
    cost = Cost(steps_to_go, reached, where, action_of, n_averaged)
    paths = trajectories(*(read[:, 1:] if action_of == "plan" else read))
    costs = cost(START, paths, np.zeros((4, 6, 1)), GOAL)
    np.testing.assert_allclose(costs, cost.simulated_steps(6) + read @ cost.weights(6))


def test_only_a_number_is_a_cost():
    cost = Cost(lambda observations, *rest: observations[:, 0], reached, "mean")
    achieved = np.full((6, 2, 1), 3.0)
    achieved[5, 1] = 0.0  # there, where d does not count
    rows = [[1, np.inf], [1, -np.inf], [-np.inf, np.inf], [np.nan, 1], [1e308, 1e308], [1, np.nan]]
    rows = np.array(rows, float)[..., None]
    costs = cost(START, Trajectories(rows, achieved, np.zeros(6, bool)), np.zeros((6, 2, 1)), GOAL)
    np.testing.assert_array_equal(costs, [np.inf, np.inf, np.inf, np.inf, np.inf, 1 + 1 / 2])
    costs = cost(START, Trajectories(rows, achieved, np.ones(6, bool)), np.zeros((6, 2, 1)), GOAL)
    np.testing.assert_array_equal(costs, np.inf)


@pytest.mark.parametrize("words", [{"where": "XXmean"}, {"action_of": "nobody"}])
def test_an_unknown_word_is_refused_and_not_taken_for_another(words):
    with pytest.raises(ValueError, match="choose one of"):
        Cost(lambda *_: None, lambda *_: None, **words)
