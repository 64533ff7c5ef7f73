"""J of a plan on trajectories written by hand, and the receding-horizon loop around it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from mpc.controller import Controller
from mpc.cost import Cost, EuclideanSteps, GivenSteps, LearnedSteps, NoSteps
from mpc.rollout import RolloutEngine, Trajectories
from napsp.distance.counts import UncertaintyConfig
from napsp.envs.dynamics import get_state
from napsp.policy.actors import GaussianPolicy
from napsp.policy.greedy import GreedyPolicy
from planners.mppi import MPPI, MPPIConfig

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


def test_euclidean_is_in_steps_and_sparse_is_zero():
    rows = np.array([[3.0, 4.0], [0.0, 0.0]])
    np.testing.assert_allclose(EuclideanSteps(0.5)(rows, rows, None, np.zeros(2)), [10.0, 0.0])
    np.testing.assert_allclose(NoSteps()(rows, rows, None, np.zeros(2)), 0.0)


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


def model(factor=1.0, distance=True, visits=None):
    """d = factor * |s + 10 a - g|, pi = g - s, and as many visits as are given."""

    def steps(states, actions, goals):
        assert states.dtype == actions.dtype == goals.dtype == torch.float32
        assert len(states) == len(actions) == len(goals)
        return factor * (states + 10 * actions - goals).abs()[:, 0]

    return SimpleNamespace(
        distance=SimpleNamespace(steps=steps) if distance else None,
        policy=SimpleNamespace(mode=lambda states, goals: goals - states),
        visits=visits,
        config=SimpleNamespace(uncertainty=UncertaintyConfig(8.0, 0.5)),
    )


def test_the_learned_distance_is_asked_at_the_plans_action_or_at_the_policys():
    rows, goal = np.array([[1.0], [4.0]]), np.array([3.0])
    found = LearnedSteps(model())(rows, rows, np.array([[0.5], [0.0]]), goal)
    np.testing.assert_allclose(found, [3.0, 1.0])
    assert found.dtype == np.float64
    np.testing.assert_allclose(LearnedSteps(model())(rows, rows, None, goal), [18.0, 9.0])  # nine times the way
    np.testing.assert_allclose(LearnedSteps(model())(rows[::-1], rows, None, goal), [9.0, 18.0])
    wide, target = np.array([[1.0, 0.0], [4.0, 0.0], [3.0, 0.0]]), np.array([3.0, 7.0])
    np.testing.assert_allclose(LearnedSteps(model())(wide, wide, None, target), [18.0, 9.0, 0.0])


def test_of_several_distances_the_largest_counts_at_the_first_models_action():
    rows, goal = np.array([[1.0], [4.0]]), np.array([3.0])
    other = model(2.0)
    other.policy = None
    third = model()
    third.distance.steps = lambda states, actions, goals: torch.tensor([99.0, 0.0])
    np.testing.assert_allclose(LearnedSteps(model(), ensemble=[other])(rows, rows, None, goal), [36.0, 18.0])
    np.testing.assert_allclose(LearnedSteps(model(), ensemble=[other, third])(rows, rows, None, goal), [99.0, 18.0])


def test_pessimism_charges_for_what_was_seldom_visited():
    asked = []

    def visits(states, actions):
        asked.append((states, actions))
        return np.array([0, 3])

    rows, goal = np.array([[1.0], [4.0]]), np.array([3.0])
    found = LearnedSteps(model(visits=visits), 0.5)(rows, rows, None, goal)
    np.testing.assert_allclose(found, [18.0 + 0.5 * 8.0, 9.0 + 0.5 * 4.0])  # U = 8 / (1 + N)^0.5
    np.testing.assert_array_equal(asked[0][0], rows)
    np.testing.assert_array_equal(asked[0][1], [[2.0], [-1.0]])
    np.testing.assert_allclose(LearnedSteps(model(visits=visits))(rows, rows, None, goal), [18.0, 9.0])
    assert len(asked) == 1, "no pessimism asks for no counts"


def test_models_without_what_is_asked_of_them_are_refused():
    for first, others in (
        (model(distance=False), []),
        (model(), [model(distance=False)]),
        (model(distance=False), [model()]),
    ):
        with pytest.raises(ValueError, match="a model holds no distance"):
            LearnedSteps(first, ensemble=others)
    with pytest.raises(ValueError, match="no visit counts"):
        LearnedSteps(model(), pessimism=0.1)


def test_given_steps_are_asked_about_achieved_goals_and_answer_in_any_number_type():
    rows, goal = np.array([[1.0], [4.0]]), np.array([3.0])
    found = GivenSteps(lambda achieved, target: np.abs(achieved - target)[:, 0].astype(int))(-rows, rows, None, goal)
    np.testing.assert_array_equal(found, [2.0, 1.0])
    assert found.dtype == np.float64
    np.testing.assert_array_equal(GivenSteps(lambda achieved, target: [1, 2])(rows, rows, None, goal), [1.0, 2.0])
    np.testing.assert_array_equal(
        GivenSteps(lambda achieved, target: achieved[:, 0])(rows, rows, None, goal), rows[:, 0]
    )
    np.testing.assert_allclose(EuclideanSteps(0.5)(-rows, rows, None, goal), [4.0, 2.0])


def controller(world, seed=0, n_threads=2, where="terminal", horizon=6, action_of="policy", n_samples=24):
    cost = Cost(EuclideanSteps(world.step_length), world.reached, where, action_of)
    planner = MPPI(horizon, world.action_space.shape[0], MPPIConfig(samples=n_samples))
    return Controller(RolloutEngine(world.dynamics, n_threads), planner, cost, horizon, np.random.default_rng(seed))


def test_planning_reaches_a_near_goal_and_leaves_the_world_alone(worlds):
    world = worlds["fetch_reach"]
    observation, _ = world.reset(seed=2)
    control = controller(world)
    success = False
    for _ in range(15):
        before = get_state(world.model, world.data)
        plan = control.plan(world, observation)
        np.testing.assert_array_equal(before, get_state(world.model, world.data))
        observation, _, _, _, info = world.step(plan.action)
        success |= info["is_success"]
    assert success
    control.engine.close()


def test_plans_are_identical_for_any_number_of_threads(worlds):
    world = worlds["fetch_wall"]
    plans = []
    for n_threads in (1, 2):
        observation, _ = world.reset(seed=0)
        control = controller(world, n_threads=n_threads)
        plans.append([control.plan(world, observation).actions for _ in range(3)])
        control.engine.close()
    np.testing.assert_array_equal(*plans)


def test_a_goal_that_is_not_finite_is_refused(worlds):
    world = worlds["point_maze"]
    observation, _ = world.reset(seed=0)
    observation["desired_goal"] = np.array([np.nan, 0.0])
    with pytest.raises(ValueError, match="not finite"):
        controller(world).plan(world, observation)


def test_all_diverged_keeps_the_plan_and_warns_once(worlds):
    world = worlds["point_maze"]
    observation, _ = world.reset(seed=0)
    control = controller(world)
    control.cost = Cost(lambda *rows: np.full(len(rows[0]), np.nan), world.reached, "terminal")
    with pytest.warns(RuntimeWarning, match="the cost of every sampled plan is not finite; keeping the prev") as caught:
        for _ in range(3):
            plan = control.plan(world, observation)
    assert len(caught) == 1
    np.testing.assert_array_equal(plan.actions, 0.0)
    control, rollout = controller(world), control.engine.rollout
    control.engine.rollout = lambda *given: replace(rollout(*given), diverged=np.ones(len(given[1]), bool))
    with pytest.warns(RuntimeWarning, match="every sampled plan diverged; keeping the previous plan"):
        plan = control.plan(world, observation)
    np.testing.assert_array_equal(plan.actions, 0.0)


def test_policy_proposals_join_the_samples(worlds):
    world = worlds["point_maze"]
    observation, _ = world.reset(seed=0)
    control = controller(world)
    control._proposals_from = [lambda observations, goals: np.full((1, 2), 0.25, np.float32)]
    seen = []
    sample = control.planner.sample
    control.planner.sample = lambda rng, proposals: seen.append(proposals) or sample(rng, proposals)
    control.plan(world, observation)
    np.testing.assert_allclose(seen[0], np.full((1, 6, 2), 0.25), atol=1e-6)


def test_following_an_actor_equals_stepping_it(worlds):
    for name in ("fetch_wall", "point_maze"):
        world = worlds[name]
        observation, _ = world.reset(seed=1)
        goal = observation["desired_goal"]

        def actor(observations, goals):
            size = world.action_space.shape[0]  # noqa: B023
            return np.tanh(observations[:, :size] * 3 - goals[:, :1]).astype(np.float32)

        with RolloutEngine(world.dynamics, 1) as engine:
            planned = engine.follow(get_state(world.model, world.data), observation, actor, 8)
        for action in planned.actions:
            rows = observation["observation"].astype(np.float32)[None], goal.astype(np.float32)[None]
            np.testing.assert_array_equal(action, actor(*rows)[0])
            observation = world.step(action)[0]


def test_a_followed_rollout_is_reused_only_for_its_own_actions(worlds):
    for name in ("fetch_wall", "point_maze"):
        world = worlds[name]
        observation, _ = world.reset(seed=2)
        size, state = world.action_space.shape[0], get_state(world.model, world.data)
        with RolloutEngine(world.dynamics, 2) as engine:
            constant = np.full((1, size), 0.4, np.float32)
            followed = engine.follow(state, observation, lambda o, g: constant, 5)  # noqa: B023
            actions = np.random.default_rng(0).uniform(-1, 1, (4, 5, size)).astype(np.float32)
            actions[2] = followed.actions
            simulated = engine.rollout(state, actions)
            reused = engine.rollout(state, actions, [followed])
            np.testing.assert_array_equal(simulated.observations, reused.observations)
            np.testing.assert_array_equal(simulated.achieved_goals, reused.achieved_goals)
            assert not reused.diverged.any()
            marked = replace(followed, features=followed.features + 1.0, times=np.zeros(5))
            reused = engine.rollout(state, actions, [marked])
        changed = (simulated.achieved_goals != reused.achieved_goals).any((1, 2))
        np.testing.assert_array_equal(changed, [False, False, True, False])
        np.testing.assert_array_equal(reused.diverged, [False, False, True, False])


def test_greedy_policy_equals_torch_and_follows_training():
    torch.manual_seed(0)
    policy = GaussianPolicy((10, 4, 3), (64, 64))
    greedy = GreedyPolicy(policy)
    with torch.no_grad():
        policy.net[0].weight.mul_(2.0)
    states, goals = torch.randn(20, 10), torch.randn(20, 3)
    np.testing.assert_allclose(
        greedy(states.numpy(), goals.numpy()), policy.mode(states, goals).detach().numpy(), atol=1e-6
    )


def test_shortest_steps_of_the_maze_are_those_of_a_hand_drawn_way(worlds):
    world = worlds["point_maze"]
    goal = np.array([0.5, 0.5])
    same_room = np.array([[0.5, 0.5], [0.3, 0.45], [0.8, 0.2]])
    steps = np.abs(same_room - goal).max(1) / 0.1  # both axes at once
    np.testing.assert_allclose(world.shortest_steps(same_room, goal), steps, atol=0.35)
    # Up through the left door (its corner at x = -0.6, y = 0.08 once inflated), then through the
    # upper one (x = 0.08, y = 0.68): each stretch costs its longer side.
    corners = np.array([[-0.3, -0.3], [-0.68, -0.08], [-0.68, 0.08], [-0.08, 0.68], [0.08, 0.68], [0.5, 0.5]])
    expected = np.abs(np.diff(corners, axis=0)).max(1).sum() / 0.1
    assert float(world.shortest_steps(corners[:1], goal)[0]) == pytest.approx(expected, abs=0.6)
    # Symmetric, and shrinking by at most one per full-speed step.
    there, back = world.shortest_steps(corners[:1], goal), world.shortest_steps(goal[None], corners[0])
    assert float(there[0]) == pytest.approx(float(back[0]), abs=0.35)


def test_given_steps_name_a_wrong_shape():
    with pytest.raises(ValueError, match="it must return"):
        GivenSteps(lambda achieved, goal: np.zeros(3))(np.zeros((5, 2)), np.zeros((5, 2)), None, np.zeros(2))


@pytest.mark.parametrize("words", [{"where": "XXmean"}, {"action_of": "nobody"}])
def test_an_unknown_word_is_refused_and_not_taken_for_another(words):
    with pytest.raises(ValueError, match="choose one of"):
        Cost(lambda *_: None, lambda *_: None, **words)
