"""Steps that are left to go from a state: learned ones, given ones and those of a straight line."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from mpc.cost import EuclideanSteps, GivenSteps, LearnedSteps, NoSteps
from napsp.distance.counts import UncertaintyConfig


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


def test_euclidean_is_in_steps_and_sparse_is_zero():
    rows = np.array([[3.0, 4.0], [0.0, 0.0]])
    np.testing.assert_allclose(EuclideanSteps(0.5)(rows, rows, None, np.zeros(2)), [10.0, 0.0])
    np.testing.assert_allclose(NoSteps()(rows, rows, None, np.zeros(2)), 0.0)


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
