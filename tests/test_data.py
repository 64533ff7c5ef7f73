"""D keeps what it is given; hindsight goals come from where they should."""

import numpy as np
import pytest

from napsp.data.buffer import EpisodeBuffer, sample_pairs
from napsp.data.episodes import FIELDS, Episodes, concatenate
from napsp.errors import UserError
from napsp.policy.her import HERConfig, sample_relabelled

LENGTH = 6


def numbered(first, n):
    """Episode e is at 100 e + t at step t, does t, and wants 100 e + 50; everything has two columns, one negated."""
    places = (100.0 * np.arange(first, first + n)[:, None] + np.arange(LENGTH + 1)[None]).astype(np.float32)
    both = np.stack([places, -places], axis=-1)
    actions = np.tile(np.arange(LENGTH, dtype=np.float32)[None, :, None], (n, 1, 3))
    return Episodes(both, both.copy(), actions, both[:, 0] + np.array([50, -50], np.float32))


def reward(achieved, goals):
    return -(np.abs(achieved - goals).max(1) > 0.5).astype(np.float32)


def test_d_keeps_every_episode_however_often_its_arrays_grow():
    buffer, parts = EpisodeBuffer(), []
    for n in (1, 2, 60, 1, 5, 200, 3, 1):  # within the first arrays, beyond them, and far beyond
        part = numbered(sum(map(len, parts)), n)
        parts.append(part)
        buffer.extend(part)
        whole, stored = concatenate(parts), buffer.episodes()
        assert len(buffer) == len(stored) == len(whole)
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(stored, name), getattr(whole, name))
    for last in (1, 5, 273, 1000):
        np.testing.assert_array_equal(buffer.episodes(last).actions, whole.actions[-last:])
        np.testing.assert_array_equal(buffer.episodes(last).observations, whole.observations[-last:])
    assert len(buffer.episodes(0)) == 0


def test_d_grows_by_doubling_and_not_at_every_episode():
    buffer = EpisodeBuffer()
    places = set()
    for first in range(300):
        buffer.extend(numbered(first, 1))
        places.add(buffer.episodes().observations.__array_interface__["data"][0])
    assert len(places) == 4  # 64, 128, 256, 512


def test_pairs_come_from_all_episodes_alike():
    pairs = sample_pairs(numbered(0, 5), 20_000, np.random.default_rng(0))
    episode = pairs.observations[:, 0] // 100
    np.testing.assert_allclose(np.bincount(episode.astype(int)) / 20_000, 0.2, atol=0.015)


def test_hindsight_goals_are_drawn_from_all_that_they_may_be():
    n, episodes = 200_000, numbered(0, 4)
    batch = sample_relabelled(episodes, n, HERConfig(0.3, 0.5), reward, np.random.default_rng(0))
    start, goal = batch.observations[:, 0].astype(int), batch.goals[:, 0].astype(int)
    own, wanted, t = start // 100 == goal // 100, goal % 100 == 50, start % 100
    assert set(t) == set(range(LENGTH)) and set(start // 100) == set(range(4))
    np.testing.assert_array_equal(batch.goals[:, 1], -goal)
    np.testing.assert_array_equal(batch.next_observations[:, 0], start + 1)
    np.testing.assert_array_equal(batch.actions, np.repeat(t[:, None], 3, axis=1))
    np.testing.assert_array_equal(batch.rewards, reward(batch.next_observations, batch.goals))
    # Of all: .2 as they were, .3 future, .25 wanted and .25 achieved by any of four episodes.
    assert (own & wanted).mean() == pytest.approx(0.2 + 0.25 / 4, abs=0.01)
    assert (~own & wanted).mean() == pytest.approx(0.25 * 3 / 4, abs=0.01)
    others = goal[~own & ~wanted] % 100
    np.testing.assert_allclose(np.bincount(others) / n, 0.25 * 3 / 4 / (LENGTH + 1), atol=0.005)
    elsewhere = goal[~own] // 100
    np.testing.assert_allclose(np.bincount(elsewhere) / n, 0.5 * 3 / 4 / 4, atol=0.01)
    assert not np.isin(episodes.desired_goals[:, 0] % 100, np.arange(LENGTH + 1)).any(), "D itself was not written to"


def test_future_goals_are_uniform_over_what_is_left_of_the_episode():
    batch = sample_relabelled(numbered(0, 3), 120_000, HERConfig(1.0), reward, np.random.default_rng(0))
    t, ahead = batch.observations[:, 0] % 100, batch.goals[:, 0] - batch.observations[:, 0]
    for step in range(LENGTH):
        found = np.bincount(ahead[t == step].astype(int), minlength=LENGTH + 1) / (t == step).sum()
        expected = np.where((np.arange(LENGTH + 1) >= 1) & (np.arange(LENGTH + 1) <= LENGTH - step), 1.0, 0.0)
        np.testing.assert_allclose(found, expected / expected.sum(), atol=0.02)


@pytest.mark.parametrize(
    ("shares", "words"),
    [
        ((-0.1, 0), "relabel_ratio is"),
        ((1.1, 0), "relabel_ratio is"),
        ((0, -0.1), "other_goals_ratio is"),
        ((0, 1.1), "other_goals_ratio is"),
        ((0.6, 0.5), "exceed 1 together"),
    ],
)
def test_shares_of_goals_lie_between_nothing_and_all(shares, words):
    for allowed in ((0, 0), (1, 0), (0, 1), (0.5, 0.5)):
        HERConfig(*allowed)
    with pytest.raises(UserError, match=words):
        HERConfig(*shares)
