"""The paper's equations against exact small cases: chains, detours, the U-sweep."""

import numpy as np
import pytest
import torch
from tabular import GridWorld, TabularDistance

from napsp.data.buffer import sample_pairs, sample_triples
from napsp.data.episodes import Episodes
from napsp.distance.labels import hypotenuse, temporal_label
from napsp.distance.learned import LearnedDistance
from napsp.distance.network import DistanceConfig, DistanceNetwork
from napsp.execution import Execution
from napsp.policy.actors import GaussianPolicy, squash
from napsp.policy.her import HERConfig, sample_relabelled
from napsp.scaling import Scaling


def chain_episodes(n_episodes=3, length=6):
    """Episode e visits positions 100 e, 100 e + 1, ...; its action at step t is t."""
    positions = np.arange(length + 1.0)[None] + 100 * np.arange(n_episodes)[:, None]
    rows = positions[..., None].astype(np.float32)
    actions = np.tile(np.arange(length, dtype=np.float32)[None, :, None], (n_episodes, 1, 1))
    return Episodes(rows, rows.copy(), actions, rows[:, -1] + 50)


# -- sampling --


def test_pairs_are_later_in_the_same_episode_and_uniform():
    pairs = sample_pairs(chain_episodes(), 60_000, np.random.default_rng(0))
    start, goal = pairs.observations[:, 0], pairs.goals[:, 0]
    np.testing.assert_array_equal(goal - start, pairs.steps_between)
    assert pairs.steps_between.min() == 1 and pairs.steps_between.max() == 6
    np.testing.assert_array_equal(pairs.actions[:, 0], start % 100)
    # 21 pairs per episode, 6 of them one step apart.
    assert (pairs.steps_between == 1).mean() == pytest.approx(6 / 21, abs=0.01)


def test_first_arrival_does_not_count_waiting_at_the_goal():
    # Two steps to the goal's region, then waiting in it: x = 0, 1, 2, 2, 2, 2, 2.
    rows = np.minimum(np.arange(7.0), 2.0)[None, :, None].astype(np.float32).repeat(3, axis=0)
    episodes = Episodes(rows, rows.copy(), np.zeros((3, 6, 1), np.float32), rows[:, -1])

    def reward(achieved, goals):
        return -(np.abs(achieved - goals)[:, 0] > 0.5).astype(np.float32)

    pairs = sample_pairs(episodes, 5_000, np.random.default_rng(0), reward)
    start, goal = pairs.observations[:, 0], pairs.goals[:, 0]
    truth = np.maximum(goal - start, 1.0)  # one action is the least: d(s, a, g) counts it
    np.testing.assert_array_equal(pairs.steps_between, truth)
    usual = sample_pairs(episodes, 5_000, np.random.default_rng(0))
    np.testing.assert_array_equal(usual.goals, pairs.goals)  # the same pairs, other labels
    assert usual.steps_between.max() == 6 and (pairs.steps_between <= usual.steps_between).all()


def test_triples_take_start_and_goal_from_one_recent_episode():
    everything, recent = chain_episodes(5), chain_episodes(2)
    triples = sample_triples(recent, everything, 5_000, np.random.default_rng(0))
    episode = triples.observations[:, 0] // 100
    np.testing.assert_array_equal(triples.goals[:, 0], 100 * episode + 56)
    assert episode.max() == 1 and (triples.waypoints[:, 0] // 100).max() == 4
    np.testing.assert_array_equal(triples.waypoint_actions[:, 0], triples.waypoints[:, 0] % 100)
    np.testing.assert_array_equal(triples.waypoint_goals, triples.waypoints)


def test_her_future_goals_and_rewards():
    episodes = chain_episodes()

    def reward(achieved, goals):
        return -(np.abs(achieved - goals)[:, 0] > 0.5).astype(np.float32)

    batch = sample_relabelled(episodes, 50_000, HERConfig(0.8), reward, np.random.default_rng(0))
    start, goal = batch.observations[:, 0], batch.goals[:, 0]
    original = goal == 100 * (start // 100) + 56
    assert original.mean() == pytest.approx(0.2, abs=0.01)
    ahead = (goal - start)[~original]
    assert ahead.min() == 1, "the transition's own next state is a legal future goal"
    assert (ahead <= 6 - start[~original] % 100).all()
    np.testing.assert_array_equal(batch.next_observations[:, 0], start + 1)
    np.testing.assert_array_equal(batch.rewards == 0, goal == start + 1)


def test_goals_of_other_episodes_are_wanted_and_achieved_ones_in_equal_parts():
    episodes = chain_episodes(200)

    def reward(achieved, goals):
        return -(np.abs(achieved - goals)[:, 0] > 0.5).astype(np.float32)

    batch = sample_relabelled(episodes, 50_000, HERConfig(0.3, 0.6), reward, np.random.default_rng(0))
    goal, episode = batch.goals[:, 0], batch.observations[:, 0] // 100
    wanted, own = goal % 100 == 56, goal // 100 == episode
    assert (own & wanted).mean() == pytest.approx(0.1, abs=0.01)  # left as they were
    assert (own & ~wanted).mean() == pytest.approx(0.3, abs=0.01)  # future
    assert (~own & wanted).mean() == pytest.approx(0.3, abs=0.01)
    assert (~own & ~wanted).mean() == pytest.approx(0.3, abs=0.01)
    np.testing.assert_array_equal(batch.rewards == 0, goal == batch.next_observations[:, 0])


# -- eq. 4a --


def test_temporal_label_never_exceeds_the_empirical_distance():
    steps, target = torch.tensor([5.0, 5.0, 5.0]), torch.tensor([2.0, 4.5, 30.0])
    label = temporal_label(steps, target, torch.tensor([1.0, 1.0, 1.0]))
    torch.testing.assert_close(label, torch.tensor([3.0, 5.0, 5.0]))


@pytest.mark.parametrize(
    ("bound", "fixed_point"), [(50, 27.5), (10, 24.8), (5, 21.0), (3, 18.1), (1, 13.1), (0.5, 10.8), (0.1, 7.4)]
)
def test_u_sweep_moves_d_from_the_mean_label_to_the_smallest(bound, fixed_point):
    """Labels uniform on {5..50}: a large U gives their mean, U -> 0 their minimum."""
    labels = torch.arange(5.0, 51.0)
    d = torch.tensor(20.0)
    for _ in range(30_000):
        d += 0.02 * (temporal_label(labels, d, torch.tensor(float(bound))).mean() - d)
    assert float(d) == pytest.approx(fixed_point, abs=0.06)


def test_temporal_regression_recovers_a_chain():
    torch.manual_seed(0)
    episodes, rng = chain_episodes(1, length=8), np.random.default_rng(0)
    config = DistanceConfig(learning_rate=1e-2)
    regression = LearnedDistance((1, 1, 1), (64, 64), 50, 64, config, Execution())
    regression.distance.scaling.set(Scaling.estimate(episodes.observations, episodes.achieved_goals))
    for _ in range(400):
        pairs = sample_pairs(episodes, 64, rng)
        inputs = regression.rows(pairs.observations, pairs.actions, pairs.goals)
        regression.fit(inputs, torch.from_numpy(pairs.steps_between), n_sampled=64)
    assert (regression.steps(inputs) - torch.from_numpy(pairs.steps_between)).abs().max() < 0.4


# -- eq. 3 and 4b --


def test_hypotenuse_is_the_capped_sum_of_both_legs():
    labels = hypotenuse(torch.tensor([1.0, 2, 3, 9]), torch.tensor([1.0, 1, 1, 8]), cap=10.0)
    torch.testing.assert_close(labels, torch.tensor([2.0, 3.0, 4.0, 10.0]))


def test_detour_of_three_nodes_raises_the_underestimate():
    """Figure 1: s -> j and j -> g were walked, s -> g never; d(s, g) starts too low."""
    table = TabularDistance(GridWorld(". . ."), start=0.0, rate=0.3)
    s, j, g = 0, 1, 2
    table.values[s, 0, j], table.values[j, 0, g], table.values[s, 0, g] = 4.0, 3.0, 1.0
    table.update_target()
    legs, whole = torch.tensor([[s, 0, j], [j, 0, g]]), torch.tensor([[s, 0, g]])
    for _ in range(60):
        first, second = table.target_steps(legs)
        table.fit(whole, hypotenuse(first[None], second[None], cap=50.0), 1)
    assert float(table.steps(whole)) == pytest.approx(7.0, abs=1e-3)


def test_without_a_cap_two_bootstraps_run_away_and_with_one_they_stay():
    for cap, bounded in ((50.0, True), (None, False)):
        d = torch.tensor([20.0])
        for _ in range(100):
            d = d + 0.3 * (hypotenuse(d, d, cap) - d)
        assert bool(d <= 50.0) is bounded


# -- networks --


def test_policy_density_integrates_to_one():
    torch.manual_seed(0)
    policy = GaussianPolicy((1, 1, 1), (4,))
    state, goal = torch.zeros(1, 1), torch.zeros(1, 1)
    mean, log_std = policy(state, goal).chunk(2, dim=-1)
    actions = torch.linspace(-0.9999, 0.9999, 20_001)
    before = torch.atanh(actions)
    density = torch.distributions.Normal(mean[0], log_std[0].exp()).log_prob(before) - torch.log(1 - actions**2)
    assert float(torch.trapezoid(density.exp().detach(), actions)) == pytest.approx(1.0, abs=1e-2)
    _, log_density, *_ = squash(
        policy(state.expand(5, 1), goal.expand(5, 1)), torch.randn(5, 1, generator=torch.Generator().manual_seed(1))
    )
    action, expected, *_ = squash(policy(state, goal), torch.randn(1, 1, generator=torch.Generator().manual_seed(3)))
    check = torch.distributions.Normal(mean, log_std.exp()).log_prob(torch.atanh(action)) - torch.log(1 - action**2)
    torch.testing.assert_close(expected, check.sum(-1), atol=1e-4, rtol=1e-4)
    assert log_density.shape == (5,)


def test_distance_is_clipped_to_the_episode():
    network = DistanceNetwork((2, 1, 2), (8,), episode_length=10).requires_grad_(False)
    with torch.no_grad():
        network.heads[0].net[-1].bias.fill_(-3.0)
    rows = torch.zeros(1, 2), torch.zeros(1, 1), torch.zeros(1, 2)
    assert float(network(*rows)) < 0 and float(network.steps(*rows)) == 0.0
    with torch.no_grad():
        network.heads[0].net[-1].bias.fill_(7.0)
    assert float(network.steps(*rows)) == 10.0


def test_constant_inputs_are_left_alone_by_the_scaling():
    rows = np.array([[1.0, 5.0], [2.0, 5.0 + 1e-7]], np.float32)
    scaled = Scaling.estimate(rows, rows).observation(rows)
    assert np.abs(scaled[:, 1]).max() < 1e-3 and np.abs(scaled[:, 0]).max() == pytest.approx(1.0)
