"""N(s, a), N(s, a, g) and eq. 2 against dictionaries."""

from collections import Counter

import numpy as np
import pytest

from napsp.data.episodes import Episodes
from napsp.distance import counts as module
from napsp.distance.counts import CountConfig, CountModel, KeyCounts, SimHash, UncertaintyConfig, uncertainty
from napsp.errors import UserError
from napsp.scaling import Scaling

SIZES = (3, 2, 2)


def random_episodes(n, rng, length=6):
    """Walks on a coarse grid, so that places are visited again and again."""
    observations = rng.integers(-1, 2, (n, length + 1, 3)).astype(np.float32)
    goals = observations[..., :2] * np.float32(0.9) + rng.uniform(-0.1, 0.1, (n, length + 1, 2)).astype(np.float32)
    return Episodes(observations, goals, rng.integers(-1, 2, (n, length, 2)).astype(np.float32), goals[:, -1])


def scalings(rng):
    return Scaling.estimate(rng.standard_normal((50, 3)), 3.0 * rng.standard_normal((50, 2)) + 1.0)


class Dictionary:
    """The same counts, worked out one pair at a time."""

    def __init__(self, model, config):
        self.model, self.edge, self.visits = model, config.goal_cell * 2, Counter()
        self.reached = [Counter() for _ in model.reached_tables]

    def pair(self, projection, observation, action):
        scaling = self.model.scaling
        inputs = [*((observation - scaling.observation_mean) / scaling.observation_scale), *action, 1.0]
        return tuple(np.asarray(inputs, np.float32) @ projection > 0)

    def cell(self, table, goal):
        scaling = self.model.scaling
        place = (goal - scaling.goal_mean) / scaling.goal_scale / self.edge + table.shift
        return tuple(int(x // 1) for x in place)

    def add(self, episodes):
        for s, goals, a in zip(episodes.observations, episodes.achieved_goals, episodes.actions, strict=True):
            for i in range(len(a)):
                self.visits[self.pair(self.model.visit_hash.projection, s[i], a[i])] += 1
                for table, counter in zip(self.model.reached_tables, self.reached, strict=True):
                    for j in range(i + 1, len(s)):
                        counter[self.pair(table.pair.projection, s[i], a[i]), self.cell(table, goals[j])] += 1

    def asked(self, s, a, g):
        seen = self.visits[self.pair(self.model.visit_hash.projection, s, a)]
        tables = zip(self.model.reached_tables, self.reached, strict=True)
        return seen, max(c[self.pair(t.pair.projection, s, a), self.cell(t, g)] for t, c in tables)


def agree(model, config, episodes, rng):
    truth = Dictionary(model, config)
    truth.add(episodes)
    asked = random_episodes(40, rng)
    rows = asked.observations[:, 0], asked.actions[:, 0], asked.achieved_goals[:, 3]
    expected = np.array([truth.asked(*row) for row in zip(*rows, strict=True)])
    np.testing.assert_array_equal(model.visits(*rows[:2]), expected[:, 0])
    np.testing.assert_array_equal(model.visit_counts(*rows[:2]), expected[:, 0])
    np.testing.assert_array_equal(model.reached(*rows), expected[:, 1])
    assert (expected == 0).any(0).all() and (expected > 2).any(0).all()
    return expected


def test_both_counts_are_those_of_a_dictionary_and_follow_another_scaling(monkeypatch):
    monkeypatch.setattr(module, "RECOUNT_CHUNK", 3)
    rng, config = np.random.default_rng(0), CountConfig(visit_bits=7, pair_bits=7, goal_cell=0.06, n_lattices=3)
    model, episodes = CountModel(SIZES, config, scalings(rng), rng), random_episodes(10, rng)
    model.update(episodes[:4])
    model.update(episodes[4:])
    first = agree(model, config, episodes, np.random.default_rng(1))
    model.recount(episodes, scalings(rng))
    assert (agree(model, config, episodes, np.random.default_rng(1)) != first).any()
    assert sum(model.visit_table.counts) == 60 and [sum(t.counts) for t in model.tables()[1:]] == [10 * 21] * 3


def test_a_long_episode_is_counted_in_parts_of_bounded_size(monkeypatch):
    rng, config = np.random.default_rng(0), CountConfig(visit_bits=7, pair_bits=7, goal_cell=0.06)
    scaling, episodes = scalings(rng), random_episodes(10, rng)
    whole, parts = (CountModel(SIZES, config, scaling, np.random.default_rng(2)) for _ in range(2))
    whole.update(episodes)
    added, add = [], module.KeyCounts.add
    monkeypatch.setattr(module.KeyCounts, "add", lambda self, keys: added.append(len(keys)) or add(self, keys))
    monkeypatch.setattr(module, "PAIRS_AT_ONCE", 130)  # of 210
    parts.update(episodes)
    assert added[0] == 60 and max(added[1:]) <= 130 and sum(added[1:]) == 3 * 210
    for one, other in zip(whole.tables(), parts.tables(), strict=True):
        np.testing.assert_array_equal(one.keys, other.keys)
        np.testing.assert_array_equal(one.counts, other.counts)


def test_the_shifts_of_lattices_are_spread_evenly_and_keys_are_odd_multiples():
    rng = np.random.default_rng(0)
    model = CountModel((3, 2, 4), CountConfig(n_lattices=4, goal_cell=0.25), Scaling(*np.zeros((4, 1))), rng)
    shifts = np.array([table.shift for table in model.reached_tables])
    np.testing.assert_allclose(np.diff(np.sort(shifts, axis=0), axis=0), 0.25)
    assert (shifts >= 0).all() and (shifts < 1).all()
    multipliers = np.array([table.multipliers for table in model.reached_tables])
    assert (multipliers % 2 == 1).all() and multipliers.shape == (4, 5) and len(np.unique(multipliers)) == 20
    assert np.abs(multipliers).min() > 2**40 and (multipliers < 0).any() and np.abs(multipliers).max() > 2**62
    assert {table.edge for table in model.reached_tables} == {1.0}
    pairs, goals = rng.standard_normal((9, 5)), rng.standard_normal((9, 4))
    for table in model.reached_tables:
        np.testing.assert_array_equal(table.pair_part(pairs), table.pair(pairs) * table.multipliers[0])
        cells = np.floor(goals + table.shift).astype(np.int64)
        np.testing.assert_array_equal(table.goal_part(goals), (cells * table.multipliers[1:]).sum(1))


def test_what_nobody_uses_of_an_action_enters_neither_count():
    rng, config = np.random.default_rng(0), CountConfig(visit_bits=30, pair_bits=30)
    model = CountModel(SIZES, config, scalings(rng), rng, np.array([True, False]))
    hashes = [model.visit_hash, *(table.pair for table in model.reached_tables)]
    assert [list((h.projection != 0).any(1)) for h in hashes] == [[True, True, True, True, False, True]] * 4
    everything = CountModel(SIZES, config, scalings(rng), rng)
    assert (everything.visit_hash.projection != 0).all()
    assert [h.projection.shape for h in hashes] == [(6, 30)] * 4


@pytest.mark.parametrize(
    ("kind", "name", "low", "high"),
    [(CountConfig, "visit_bits", 1, 62), (CountConfig, "pair_bits", 1, 62), (CountConfig, "n_lattices", 1, 100),
     (CountConfig, "goal_cell", 1e-12, 10**9), (UncertaintyConfig, "scale", 1e-12, 10**9),
     (UncertaintyConfig, "power", 1e-12, 100)],
)  # fmt: skip
def test_bounds_of_the_options(kind, name, low, high):
    for value in (low, high):
        assert getattr(kind(**{name: value}), name) == value
    for value in (low - 1, high + 1, float("nan")):
        with pytest.raises(UserError, match=f"{name} is"):
            kind(**{name: value})


def chain_episodes(n_episodes=3, length=6):
    """Episode e visits positions 100 e, 100 e + 1, ...; its action at step t is t."""
    positions = np.arange(length + 1.0)[None] + 100 * np.arange(n_episodes)[:, None]
    rows = positions[..., None].astype(np.float32)
    actions = np.tile(np.arange(length, dtype=np.float32)[None, :, None], (n_episodes, 1, 1))
    return Episodes(rows, rows.copy(), actions, rows[:, -1] + 50)


def test_counts_equal_a_dictionary():
    rng, table, truth = np.random.default_rng(0), KeyCounts(), {}
    assert not table.count(np.arange(3)).any()
    for _ in range(5):
        keys = rng.integers(-300, 300, 200)
        table.add(keys)
        for key in keys:
            truth[key] = truth.get(key, 0) + 1
    probe = np.arange(-400, 400)
    expected = [truth.get(key, 0) for key in probe]
    np.testing.assert_array_equal(table.count(probe), expected)
    assert 0 in expected and sum(truth.values()) == table.counts.sum()
    table.clear()
    assert not table.count(probe).any()


def test_a_simhash_is_the_signs_of_affine_projections_of_the_inputs_in_use():
    rng = np.random.default_rng(0)
    used = np.array([True, False, True])
    for n_bits in (1, 8, 16, 33, 62):
        simhash = SimHash.drawn(used, n_bits, rng)
        rows = rng.standard_normal((20, 3))
        bits = rows @ simhash.projection[:-1] + simhash.projection[-1] > 0
        np.testing.assert_array_equal(simhash(rows), bits @ (1 << np.arange(n_bits)))
        np.testing.assert_array_equal(
            simhash(rows), simhash(rows + np.array([0, 9.0, 0])), "what nobody uses does not enter"
        )
        assert n_bits < 8 or (simhash(rows) != simhash(rows + np.array([9.0, 0, 0]))).any()


def unscaled(n_goal=1):
    return Scaling(np.zeros(1), np.ones(1), np.zeros(n_goal), np.ones(n_goal))


def test_reached_counts_each_later_pair_once():
    episodes = chain_episodes(1, length=4)
    scaling = Scaling.estimate(episodes.observations, episodes.achieved_goals)
    counts = CountModel((1, 1, 1), CountConfig(62, 62, 0.5, 2), scaling, np.random.default_rng(0))
    counts.update(episodes)
    counts.update(episodes)
    states, actions, goals = episodes.observations[0], episodes.actions[0], episodes.achieved_goals[0]
    for i in range(4):
        row = states[i : i + 1], actions[i : i + 1]
        assert counts.visits(*row) == 2
        for j in range(5):
            expected = 2 if j > i else 0
            assert counts.reached(*row, goals[j : j + 1]) == expected, (i, j)


def test_goals_are_told_apart_at_their_own_resolution_and_borders_do_not_hide_them():
    """Cells of edge e: two edges away is never the same goal; a tenth of an edge away nearly always is."""
    rng, n = np.random.default_rng(0), 2000
    counts = CountModel((1, 1, 2), CountConfig(goal_cell=0.5, n_lattices=2), unscaled(2), rng)
    edge = 0.5 * 2
    goals, aside = rng.uniform(-3, 3, (n, 2)), rng.standard_normal((n, 2))
    aside *= edge / np.linalg.norm(aside, axis=1, keepdims=True)

    def same(offset):
        parts = [(table.goal_part(goals), table.goal_part(goals + offset)) for table in counts.reached_tables]
        return np.array([own == other for own, other in parts])

    assert same(0.0 * aside).all() and not same(2.0 * aside).any()
    near = same(0.1 * aside)
    assert near.any(0).mean() > 0.97, "in one of two lattices"
    assert near[0].mean() < 0.93, "one alone has borders"


def test_recounting_under_the_same_scaling_changes_nothing():
    episodes = chain_episodes(5)
    counts = CountModel((1, 1, 1), CountConfig(), unscaled(), np.random.default_rng(0))
    counts.update(episodes)
    before = [(table.keys, table.counts) for table in counts.tables()]
    counts.recount(episodes, unscaled())
    for table, (keys, numbers) in zip(counts.tables(), before, strict=True):
        np.testing.assert_array_equal(table.keys, keys)
        np.testing.assert_array_equal(table.counts, numbers)


def test_uncertainty_is_equation_2():
    np.testing.assert_allclose(uncertainty(np.array([0, 3, 99]), 10.0, 0.5), [10.0, 5.0, 1.0])
    np.testing.assert_allclose(uncertainty(np.array([1]), 8.0, 3.0), [1.0])
    np.testing.assert_allclose(UncertaintyConfig(8.0, 3.0)(np.array([1, 0])), [1.0, 8.0])
