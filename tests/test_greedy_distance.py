"""Following d downhill: a = argmin_a d(s, a, g)."""

import itertools

import numpy as np
import torch

from napsp.distance.network import DistanceNetwork
from napsp.policy.greedy_distance import GreedyDistance
from napsp.storage.checkpoint import load_model
from napsp.storage.shipped import shipped_model
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session


class Bowl(DistanceNetwork):
    """|a - (s + g)|^2: the best action is known."""

    def forward(self, observation, action, goal):
        return (action - observation - goal).square().sum(-1)


def test_the_least_distance_of_a_bowl_is_found():
    greedy = GreedyDistance(Bowl((2, 2, 2), (4,), 50), 2)
    rng = np.random.default_rng(0)
    observations, goals = rng.uniform(-0.4, 0.4, (2, 20, 2)).astype(np.float32)
    np.testing.assert_allclose(greedy(observations, goals), observations + goals, atol=0.08)
    far = greedy(observations + 5, goals)
    np.testing.assert_allclose(far, 1.0, atol=0.1)
    assert np.abs(far).max() <= 1.0


def test_on_a_trained_distance_it_equals_a_grid_of_actions_and_does_not_depend_on_the_batch():
    distance = load_model(shipped_model("point_maze"), "point_maze").distance
    greedy = GreedyDistance(distance, 2)
    rng = np.random.default_rng(1)
    observations = np.concatenate([rng.uniform(0.1, 1.9, (8, 2)), np.zeros((8, 2))], 1).astype(np.float32)
    goals = rng.uniform(0.1, 1.9, (8, 2)).astype(np.float32)
    found = greedy(observations, goals)
    np.testing.assert_allclose(greedy(observations[3:4], goals[3:4])[0], found[3], atol=1e-4)
    grid = torch.tensor(list(itertools.product(np.linspace(-1, 1, 9), repeat=2)), dtype=torch.float32)
    rows = torch.from_numpy(observations), torch.from_numpy(goals)
    with torch.inference_mode():
        least = torch.stack([distance(rows[0], action.expand(8, -1), rows[1]) for action in grid]).amin(0)
        steps = distance(rows[0], torch.from_numpy(found), rows[1])
    assert (steps <= least + 0.2).all()


def test_greedy_proposals_join_the_samples_and_are_the_same_every_time():
    plans = []
    for _ in range(2):
        changes = {"env": "point_maze", "search.samples": 4, "horizon": 4}
        proposals = {"proposals": False, "distance.greedy_proposals": True}
        session = Session.open(PlanConfig.of("mppi", changes | proposals), RunOptions(threads=1))
        seen = []
        sample = session.controller.planner.sample
        session.controller.planner.sample = lambda rng, proposals: seen.append(proposals) or sample(rng, proposals)  # noqa: B023
        observation, _ = session.env.reset(seed=0)
        plan = session.controller.plan(session.env.unwrapped, observation)
        session.close()
        assert seen[0].shape == (1, 4, 2)
        plans.append(np.concatenate([seen[0][0], plan.actions]))
    np.testing.assert_array_equal(*plans)


def test_greedy_proposals_are_another_configuration():
    usual, greedy = (PlanConfig.of("mppi", {"distance.greedy_proposals": on}).identity() for on in (False, True))
    assert usual == {"horizon": 5} and greedy == {"horizon": 5, "distance.greedy_proposals": True}
