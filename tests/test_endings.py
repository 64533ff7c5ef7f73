"""Episodes end when they end: what is collected, drawn, counted and learned of them, and what follows an end."""

from collections import Counter

import numpy as np
import pytest
import torch
from gymnasium.wrappers import TimeLimit
from line import Line
from tabular import ExactCounts, GridWorld, TabularDistance
from tiny import tiny

from napsp.data.buffer import EpisodeBuffer, sample_pairs, sample_triples
from napsp.data.collect import roll
from napsp.data.episodes import ARRIVED, BLOWN, CUT, LOST, Episodes, concatenate, draw_steps
from napsp.data.explorers import Ongoing
from napsp.data.outcomes import outcomes
from napsp.distance.counts import CountConfig, CountModel
from napsp.distance.graph import GraphConfig, ReplayGraph, explained
from napsp.distance.labels import one_step_label
from napsp.learner import Learner, scaling_of
from napsp.policy.agent import PolicyBatch
from napsp.policy.her import HERConfig, sample_relabelled
from napsp.scaling import Scaling
from napsp.storage.files import checksum_of, write_tensors

LENGTHS, ENDINGS = np.array([6, 2, 1, 0, 4]), np.array([CUT, ARRIVED, LOST, BLOWN, CUT], np.uint8)
NAN = np.float32(np.nan)


def uneven(endings=ENDINGS, padding=NAN):
    """Episode e is at 100 e + t at step t and does t; what stands after its end may be anything."""
    places = (100.0 * np.arange(5)[:, None] + np.arange(7)).astype(np.float32)[..., None]
    actions = np.tile(np.arange(6, dtype=np.float32)[None, :, None], (5, 1, 1))
    for e, length in enumerate(LENGTHS):
        places[e, length + 1 :], actions[e, length:] = padding, padding
    desired = places[np.arange(5), LENGTHS] + np.array([[50], [0], [50], [50], [50]], np.float32)
    return Episodes(places, places.copy(), actions, desired, LENGTHS, endings)


def reward(achieved, goals):
    assert np.isfinite(achieved).all() and np.isfinite(goals).all()
    return -(np.abs(achieved - goals)[:, 0] > 0.5).astype(np.float32)


def act(speed):
    return lambda observations, goals: np.full((len(observations), 1), speed)


def test_collection_stops_where_an_environment_ends_and_tells_why():
    worlds = [Line(), Line(ends_at_goal=True), Line(edge=1.6), Line(limit=5), Line(nan_beyond=2.2), Line(nan_beyond=0)]
    with pytest.warns(RuntimeWarning, match="the simulation of Line blew up"):
        episodes = roll(worlds, act(0.5), list(range(6)), 8)
    assert episodes.lengths.tolist() == [8, 6, 4, 5, 4, 0]
    assert episodes.endings.tolist() == [CUT, ARRIVED, LOST, CUT, BLOWN, BLOWN]
    steps = np.minimum(np.arange(9), episodes.lengths[:, None])
    np.testing.assert_array_equal(episodes.observations[..., 0], 0.5 * steps)  # the last state stays
    np.testing.assert_array_equal(episodes.actions[..., 0], np.where(episodes.happened(), 0.5, 0.0))
    assert not episodes.whole and episodes.n_steps == 27 and episodes.seen().sum() == 27 + 6


def test_d_keeps_lengths_and_endings():
    buffer = EpisodeBuffer()
    for _ in range(30):
        buffer.extend(uneven())
    stored = buffer.episodes()
    np.testing.assert_array_equal(stored.lengths, np.tile(LENGTHS, 30))
    np.testing.assert_array_equal(stored[5:10].endings, ENDINGS)
    assert stored.endings.dtype == np.uint8 and stored.lengths.dtype == np.int64


def test_every_step_is_as_likely_and_none_after_an_end_is_drawn():
    n, rng = 130_000, np.random.default_rng(0)
    episode, t = draw_steps(uneven(), n, rng)
    found = Counter(zip(episode.tolist(), t.tolist(), strict=True))
    assert set(found) == {(e, t) for e, length in enumerate(LENGTHS) for t in range(length)}
    np.testing.assert_allclose(np.array(list(found.values())) / n, 1 / 13, atol=0.004)


def test_pairs_lie_within_their_episode_all_of_one_as_likely():
    n = 130_000
    pairs = sample_pairs(uneven(), n, np.random.default_rng(0))
    start, goal = pairs.observations[:, 0].astype(int), pairs.goals[:, 0].astype(int)
    np.testing.assert_array_equal(goal - start, pairs.steps_between)
    np.testing.assert_array_equal(start % 100, pairs.actions[:, 0])
    assert (start // 100 == goal // 100).all() and (goal > start).all()
    for e, length in enumerate(LENGTHS):
        counts = np.array(list(Counter(zip(start[start // 100 == e], goal[start // 100 == e], strict=True)).values()))
        assert len(counts) == length * (length + 1) / 2
        np.testing.assert_allclose(counts / n, length / 13 / max(1, len(counts)), atol=0.004)
    early = sample_pairs(uneven(), 1000, np.random.default_rng(0), lambda a, g: reward(a, np.minimum(g, a)))
    assert (early.steps_between == 1).all()


def test_hindsight_goals_and_what_follows_lie_within_episodes():
    drawn = sample_relabelled(uneven(), 50_000, HERConfig(0.5, 0.4), reward, np.random.default_rng(0))
    start, goal = drawn.observations[:, 0].astype(int), drawn.goals[:, 0].astype(int)
    future = np.isfinite(drawn.steps_between)
    np.testing.assert_array_equal(drawn.next_observations[:, 0], start + 1)
    np.testing.assert_array_equal((goal - start)[future], drawn.steps_between[future])
    at_end = goal % 100 == LENGTHS[goal // 100]
    np.testing.assert_array_equal(np.isnan(drawn.after[future, 0]), at_end[future])
    np.testing.assert_array_equal(drawn.after[future & ~at_end, 0], goal[future & ~at_end] + 1)
    others = Counter(goal[~future & (goal // 100 != start // 100) & (goal % 100 <= LENGTHS[goal // 100])])
    assert set(others) == {100 * e + t for e, length in enumerate(LENGTHS) for t in range(length + 1)}


def test_triples_know_which_actions_lost_everything():
    triples = sample_triples(uneven(), uneven(), 2000, np.random.default_rng(0))
    np.testing.assert_array_equal(triples.lost, triples.observations[:, 0] == 200)
    for rows in (triples.observations, triples.waypoints):
        assert set(rows[:, 0].astype(int)) == {100 * e + t for e, length in enumerate(LENGTHS) for t in range(length)}


def ended(endings, her=HERConfig(0.5, 0.0)):  # noqa: B008 - frozen
    """What follows each (start, goal) that is drawn."""
    drawn = sample_relabelled(uneven(endings), 5000, her, reward, np.random.default_rng(0))
    rows = zip(drawn.observations[:, 0], drawn.goals[:, 0], drawn.ended, strict=True)
    return {(int(s), int(g)): None if np.isnan(e) else float(e) for s, g, e in rows}


def test_the_world_goes_on_beyond_a_time_limit_and_a_blow_up():
    for ending in (CUT, BLOWN):
        assert set(ended(np.full(5, ending, np.uint8)).values()) == {None}


def test_where_an_episode_is_lost_no_goal_is_reached_any_more():
    found = ended(np.array([CUT, LOST, LOST, CUT, CUT], np.uint8))
    # Episode 1 was lost in its second step, at its goal; episode 2 in its only one, short of its goal.
    assert found[101, 102] == 0.0 and found[200, 251] == 1.0 and found[200, 201] == 0.0
    others = {pair: value for pair, value in found.items() if pair not in ((101, 102), (200, 251), (200, 201))}
    assert len(others) > 20 and set(others.values()) == {None}


def test_where_arriving_ends_episodes_it_does_so_at_every_goal_and_is_no_end_on_the_way_to_others():
    found = ended(np.array([CUT, ARRIVED, CUT, CUT, CUT], np.uint8), HERConfig(0.5, 0.2))
    assert found[101, 102] == 0.0 and found[100, 101] == 0.0 and found[2, 3] == 0.0, "hindsight: it would have ended"
    elsewhere = {value for (start, goal), value in found.items() if goal != start + 1}
    assert elsewhere == {None} and any(start == 101 and goal != 102 for start, goal in found)


def test_critics_learn_the_value_of_never_arriving_at_a_lost_end():
    rows = [torch.zeros(4, 1)] * 4
    batch = PolicyBatch(*rows, torch.tensor([-1.0, -1.0, 0.0, -0.5]), torch.tensor([NAN, 1.0, 0.0, 0.0]))
    found = batch.targets(torch.tensor([-3.0, -3.0, -3.0, -3.0]), 0.9, (-10.0, 0.0))
    torch.testing.assert_close(found, torch.tensor([-1.0 - 0.9 * 3.0, -10.0, 0.0, -0.5]))


def test_labels_of_one_step_know_both_ends():
    arrived, ends = torch.tensor([True, True, False, False]), torch.tensor([NAN, 0.0, 1.0, NAN])
    unknown = torch.full((4,), NAN)
    labels = one_step_label(arrived, torch.full((4,), 7.0), torch.full((4,), torch.inf), unknown, 50.0, 0.5, ends)
    torch.testing.assert_close(labels, torch.tensor([1.0 + 0.5 * 6.0, 1.0, 50.0, 8.0]))


def test_counts_see_each_pair_up_to_the_end_once():
    model = CountModel((1, 1, 1), CountConfig(), Scaling(*np.zeros((1, 1)), *np.ones((1, 1)), *np.zeros((1, 1)),
                       *np.ones((1, 1))), np.random.default_rng(0))  # fmt: skip
    model.update(uneven(padding=np.float32(0.0)))
    assert [table.counts.sum() for table in model.tables()] == [13, 21 + 3 + 1 + 10] + [21 + 3 + 1 + 10] * 2


def test_scaling_and_graph_read_no_row_after_an_end():
    rng = np.random.default_rng(0)
    steps = rng.integers(-1, 2, (300, 12, 1)).astype(np.float32)
    places = np.concatenate([np.zeros((300, 1, 1)), np.cumsum(steps, 1)], 1).astype(np.float32)
    whole = Episodes(places, places, steps, places[:, 0])
    cut = rng.integers(0, 13, 300)
    far = np.where((np.arange(13) > cut[:, None])[..., None], np.float32(1e6), places)
    parts = Episodes(far, far, np.where(parts_of(cut), steps, NAN), places[:, 0], cut)
    shown = np.concatenate([places[e, : cut[e] + 1] for e in range(300)])
    np.testing.assert_allclose(scaling_of(parts).observation_mean, shown.mean(0), rtol=1e-4, atol=1e-5)
    assert explained(parts) == pytest.approx(1.0) == explained(whole)
    graph = ReplayGraph(GraphConfig(occupancy=2), lambda a, g: -(np.abs(a - g)[:, 0] > 0.1).astype(np.float32))
    graph.build(parts, 0)
    assert graph.n_cells == len(np.unique(shown))
    assert graph.steps(np.float32([[0]]), np.float32([[2]])) == pytest.approx(2.0, abs=0.4)


def parts_of(cut):
    return (np.arange(12) < cut[:, None])[..., None]


def test_actions_that_lose_everything_are_t_steps_from_the_goal_they_missed():
    world = GridWorld(length=5)
    episodes = world.random_episodes(40, np.random.default_rng(0))
    lost = Episodes(*list(vars(episodes).values())[:4], np.full(40, 2), np.full(40, LOST, np.uint8))
    distance, counts, buffer = TabularDistance(world, 5.0, rate=1.0), ExactCounts(world), EpisodeBuffer()
    buffer.extend(lost)
    config = tiny(n_triangular_updates=20, batch_size=64)
    learner = Learner(config, distance, counts, None, buffer, reward, np.random.default_rng(0), torch.Generator())
    learner.train_triangular(lost)
    last = lost.observations[:, 1, 0].astype(int), lost.actions[:, 1, 0].astype(int)
    wanted = lost.desired_goals[:, 0].astype(int)
    assert (distance.values[(*last, wanted)] == config.episode_length).float().mean() > 0.9


def test_nothing_is_learned_of_iterations_in_which_everything_blew_up_at_once():
    nothing = concatenate([uneven()[3:4]] * 2)
    learner = Learner(tiny(), None, None, None, EpisodeBuffer(), reward, np.random.default_rng(0), torch.Generator())
    assert nothing.n_steps == 0 and learner.train_triangular(nothing) == {}
    learner.buffer.extend(nothing)  # all that --replay-capacity left
    assert learner.train_policy() == learner.train_jointly() == {}


def test_counts_of_nothing_are_saved(tmp_path):
    strided = np.zeros((3, 2), np.int64)[:0, 0]
    write_tensors(tmp_path / "counts", {"keys": torch.from_numpy(strided)}, {})
    assert len(checksum_of({"keys": torch.from_numpy(strided)}, "")) == 64


def right(observations, goals):
    return np.ones((len(observations), 1), np.float32)


def test_an_explorer_that_passes_the_environments_own_goal_was_cut_there():
    explorer = Ongoing(TimeLimit(Line(goal=3.0, ends_at_goal=True), 8), anew=100)
    explorer.goal = np.array([50.0])
    episodes = roll([explorer], right, [0], 8)
    assert (episodes.lengths.tolist(), episodes.endings.tolist()) == ([3], [CUT])
    assert explorer.last is None, "it has to begin anew"


def test_an_explorer_in_an_environment_that_counts_its_steps_begins_anew_at_once_when_that_runs_out():
    explorer = Ongoing(TimeLimit(CountsOn(limit=8), 8), anew=100)
    lengths = [int(roll([explorer], right, [0], 8).lengths[0]) for _ in range(5)]
    assert lengths == [8, 1, 8, 8, 8], "found out once"


class CountsOn(Line):
    """Ends again at every step beyond its limit."""

    def step(self, action):
        self.over = False
        return super().step(action)


def test_after_a_blow_up_nobody_is_at_a_goal():
    env = Line(start=3.0, goal=3.0, nan_beyond=3.5)
    with pytest.warns(RuntimeWarning, match="blew up"):
        episodes = roll([env], right, [0], 4)
    assert episodes.endings.tolist() == [BLOWN] and not outcomes(env, episodes).reached[:, -1].any()
