"""Lines 3 to 22 of Algorithm 1: which samples were drawn, which labels they got, who was asked, what changed after."""

import numpy as np
import pytest
import torch

from napsp.config import preset
from napsp.data.buffer import EpisodeBuffer
from napsp.data.episodes import Episodes, concatenate
from napsp.learner import Learner, scaling_of

LENGTH = 50


def walk(n_episodes, first=0, waits=False):
    """Episode e is at 1000 e + t at step t; its action is t / 100; it wanted 1000 e + 700."""
    steps = np.arange(LENGTH + 1.0)
    positions = (np.minimum(steps, 10.0) if waits else steps)[None] + 1000 * (first + np.arange(n_episodes)[:, None])
    rows = positions[..., None].astype(np.float32)
    actions = np.tile(np.arange(LENGTH, dtype=np.float32)[None, :, None] / 100, (n_episodes, 1, 1))
    return Episodes(rows, rows.copy(), actions, (rows[:, 0] // 1000) * 1000 + 700)


class RecordingDistance:
    """Says what it likes, and remembers what it was asked and told."""

    def __init__(self):
        self.calls, self.fits = [], []

    def rows(self, observations, actions, goals):
        assert observations.shape[1] == actions.shape[1] == goals.shape[1] == 1
        return torch.from_numpy(np.concatenate([observations, actions, goals], axis=1))

    def steps(self, rows):
        self.calls.append(("steps", rows))
        return 3.0 + rows[:, 0] / 1e4

    def target_steps(self, rows):
        self.calls.append(("target", rows))
        return 20.0 + rows[:, 0] / 1e4

    def fit(self, rows, labels, n_sampled, weight=1.0):
        self.calls.append(("fit", rows))
        self.fits.append((rows, labels, n_sampled, weight))
        return torch.tensor(2.0), torch.full((len(rows),), 25.0)

    def update_target(self):
        self.calls.append(("update_target", None))

    def rescale(self, scaling):
        self.calls.append(("rescale", scaling))

    def asked(self, kind):
        return [rows for name, rows in self.calls if name == kind]


class GivenCounts:
    """N(s, a) = t, the step; N(s, a, g) > 0 for states of even number (any other number if ``nobody``)."""

    def __init__(self, nobody=False):
        self.nobody, self.calls = nobody, []

    def visits(self, observations, actions):
        np.testing.assert_allclose(actions * 100, observations % 1000, atol=1e-3)
        self.calls.append("visits")
        return np.round(observations[:, 0]) % 1000

    def reached(self, observations, actions, goals):
        np.testing.assert_allclose(actions * 100, observations % 1000, atol=1e-3)
        np.testing.assert_array_equal(goals[:, 0] % 1000, 700)
        self.calls.append("reached")
        return np.zeros(len(goals), int) if self.nobody else (observations[:, 0] % 2 == 0).astype(int)

    def update(self, episodes):
        self.calls.append(("update", episodes))

    def recount(self, episodes, scaling):
        self.calls.append(("recount", len(episodes), scaling))


class RecordingAgent:
    def __init__(self):
        self.trained, self.scalings = [], []

    def train(self, transitions, batch_size, generator):
        self.trained.append((transitions, batch_size))
        return {"critic_loss": 1.5}

    def rescale(self, scaling):
        self.scalings.append(scaling)


def reward(achieved, goals):
    return -(np.abs(achieved - goals)[:, 0] > 0.5).astype(np.float32)


def learner(method="ours", counts=None, everything=None, **changes):
    work = {"n_temporal_updates": 4, "n_triangular_updates": 3, "n_policy_updates": 5, "batch_size": 64}
    config = preset("fetch_wall", method, changes={**work, **changes})
    assert config.episode_length == LENGTH
    buffer = EpisodeBuffer()
    buffer.extend(walk(6) if everything is None else everything)
    parts = RecordingDistance(), counts or GivenCounts(), RecordingAgent()
    return Learner(config, *parts, buffer, reward, np.random.default_rng(0), torch.Generator(), len(buffer))


# -- lines 5 to 8: eq. 4a --


def test_temporal_labels_are_the_least_of_steps_between_and_d_old_plus_u():
    subject = learner()
    metrics = subject.train_temporal(walk(2, first=6))
    rows, labels = (torch.cat([fit[k] for fit in subject.distance.fits]) for k in (0, 1))
    assert [(len(fit[0]), *fit[2:]) for fit in subject.distance.fits] == [(64, 64, 1.0)] * 4
    i, j = rows[:, 0] % 1000, rows[:, 2] % 1000
    assert (rows[:, 0] // 1000 == rows[:, 2] // 1000).all(), "both states are of one episode"
    assert (j > i).all() and float(i.min()) == 0 and float(j.max()) == LENGTH
    torch.testing.assert_close(rows[:, 1] * 100, i, atol=1e-3, rtol=0)  # the action taken at i
    assert set((rows[:, 0] // 1000).tolist()) == set(range(6)), "D, without D_last: line 22 comes last"
    bonus = 10.0 / (1.0 + i) ** 0.5
    expected = torch.minimum(j - i, 20.0 + rows[:, 0] / 1e4 + bonus)
    torch.testing.assert_close(labels, expected)
    assert (labels < j - i).any() and (labels == j - i).any(), "both sides of the min occur"
    assert metrics == {"temporal_loss": 2.0, "mean_label": pytest.approx(float(expected.mean()))}


def test_labels_of_eq_4a_come_from_the_frozen_network_alone():
    subject = learner()
    subject.train_temporal(walk(2))
    assert [name for name, _ in subject.distance.calls] == ["target", *["fit"] * 4]
    assert subject.counts.calls == ["visits"]


def test_on_policy_ddl_regresses_on_what_the_policy_of_late_has_done():
    subject = learner("ddl", **{"temporal.ddl_window": 5})
    subject.train_temporal(walk(2, first=6))
    rows, labels = (torch.cat([fit[k] for fit in subject.distance.fits]) for k in (0, 1))
    assert set((rows[:, 0] // 1000).tolist()) == {3, 4, 5, 6, 7}, "the last five episodes, D_last included"
    torch.testing.assert_close(labels, rows[:, 2] - rows[:, 0])
    assert not subject.counts.calls and not subject.distance.asked("target")
    subject = learner("ddl", **{"temporal.ddl_window": 2})
    subject.train_temporal(walk(2, first=6))
    assert set((torch.cat([fit[0] for fit in subject.distance.fits])[:, 0] // 1000).tolist()) == {6, 7}


def test_first_arrival_is_an_option_of_the_label():
    for first_arrival in (False, True):
        subject = learner("ddl", everything=walk(3, waits=True), **{"temporal.first_arrival": first_arrival})
        subject.train_temporal(walk(20, waits=True))
        rows, labels = (torch.cat([fit[k] for fit in subject.distance.fits]) for k in (0, 1))
        waited = (rows[:, 0] % 1000 >= 10) & (rows[:, 2] % 1000 >= 10)
        assert waited.any() and bool((labels[waited] == 1.0).all()) is first_arrival


# -- line 9 --


def test_the_target_is_updated_when_line_9_says_so():
    subject = learner()
    subject.train_temporal(walk(2))
    subject.train_triangular(walk(2))
    subject.train_policy()
    assert not subject.distance.asked("update_target")
    subject.update_target()
    assert len(subject.distance.asked("update_target")) == 1


# -- lines 10 to 17: eq. 3 and 4b --


def test_triangular_labels_are_hypotenuses_through_waypoints_that_know_the_goal():
    subject = learner(**{"triangular.weight": 0.5})
    metrics = subject.train_triangular(walk(2, first=6))
    first, second = subject.distance.asked("target")
    rows, labels = (torch.cat([fit[k] for fit in subject.distance.fits]) for k in (0, 1))
    starts = rows[:, 0]
    assert set((starts // 1000).tolist()) == {6, 7}, "s_i is of D_last"
    torch.testing.assert_close(rows[:, 2], starts // 1000 * 1000 + 700)  # s_g: what its episode wanted
    assert (starts % 2 == 1).all(), "N(s_i, a_i, s_g) == 0"
    assert (second[:, 0] % 2 == 0).all(), "N(s_j, a_j, s_g) > 0"
    assert set((second[:, 0] // 1000).tolist()) == set(range(6)), "s_j is of D"
    torch.testing.assert_close(first[:, :2], rows[:, :2])
    torch.testing.assert_close(first[:, 2], second[:, 0])  # d(s_i, a_i, phi(s_j)): here phi(s) = s
    torch.testing.assert_close(second[:, 2], rows[:, 2])  # d(s_j, a_j, s_g)
    torch.testing.assert_close(second[:, 1] * 100, second[:, 0] % 1000, atol=1e-3, rtol=0)
    expected = (40.0 + (first[:, 0] + second[:, 0]) / 1e4).clamp(max=LENGTH)
    torch.testing.assert_close(labels, expected)
    assert not subject.distance.asked("steps"), "both legs are d_old's"
    assert [fit[2:] for fit in subject.distance.fits] == [(64, 0.5)] * 3, "the others of the 64 do nothing"
    assert sum(len(fit[0]) for fit in subject.distance.fits) == len(labels)
    assert 0.15 < len(labels) / (3 * 64) < 0.35
    assert metrics == {"merging_rate": pytest.approx(len(labels) / 192), "relaxation_rate": 0.0}  # 40 > 25


def test_relaxations_are_labels_below_what_d_said():
    subject = learner()
    subject.distance.target_steps = lambda rows: torch.full((len(rows),), 10.0)
    metrics = subject.train_triangular(walk(2))
    passed = sum(len(fit[0]) for fit in subject.distance.fits)
    assert metrics == {"merging_rate": 0.0, "relaxation_rate": pytest.approx(passed / 192)}  # 20 < 25


def test_the_hypotenuse_is_capped_at_the_episode_unless_told_otherwise():
    for cap, highest in ((True, 50.0), (False, 80.0)):
        subject = learner(**{"triangular.cap": cap})
        subject.distance.target_steps = lambda rows: torch.full((len(rows),), 40.0)
        subject.train_triangular(walk(2))
        assert float(subject.distance.fits[0][1].max()) == highest


def test_line_13_can_be_that_of_the_text():
    subject = learner(**{"triangular.require_reached_waypoint": False})
    subject.train_triangular(walk(2))
    waypoints = subject.distance.asked("target")[1][:, 0]
    assert (waypoints % 2 == 0).any() and (waypoints % 2 == 1).any()


def test_eq_4b_can_average_over_the_tuples_that_pass():
    subject = learner(**{"triangular.mean": "passed"})
    subject.train_triangular(walk(2))
    assert all(n_sampled == len(rows) for rows, _, n_sampled, _ in subject.distance.fits)


def test_where_no_way_is_known_the_triangular_phase_does_nothing():
    subject = learner(counts=GivenCounts(nobody=True))
    assert subject.train_triangular(walk(2)) == {"merging_rate": 0.0, "relaxation_rate": 0.0}
    assert not subject.distance.fits


# -- lines 18 to 21 --


@pytest.mark.parametrize("method", ["ours", "sparse"])
def test_the_policy_learns_on_relabelled_transitions_with_reward_minus_d(method):
    subject = learner(method)
    metrics = subject.train_policy()
    (transitions, batch_size) = subject.agent.trained[0]
    assert batch_size == 64 and len(transitions.rewards) == 5 * 64 and len(subject.agent.trained) == 1
    states, actions, following, goals = (t[:, 0] for t in transitions[:4])
    torch.testing.assert_close(following, states + 1)
    torch.testing.assert_close(actions * 100, states % 1000, atol=1e-3, rtol=0)
    relabelled = goals % 1000 != 700
    assert float(relabelled.float().mean()) == pytest.approx(0.8, abs=0.07)
    assert (goals > states)[relabelled].all() and (goals - states)[relabelled].max() <= LENGTH
    if method == "sparse":
        torch.testing.assert_close(transitions.rewards, -(goals != following).float())
        assert not subject.distance.calls and metrics == {"critic_loss": 1.5}
        return
    (asked,) = subject.distance.asked("steps")
    torch.testing.assert_close(asked, torch.stack([states, actions, goals], dim=1))
    torch.testing.assert_close(transitions.rewards, -(3.0 + states / 1e4) / LENGTH)
    assert not subject.distance.asked("target"), "today's d rewards, not the frozen one"
    assert metrics == {"mean_distance": pytest.approx(float(3.0 + states.mean() / 1e4)), "critic_loss": 1.5}


def test_no_updates_are_no_work():
    subject = learner(n_temporal_updates=0, n_triangular_updates=0, n_policy_updates=0)
    assert subject.train_temporal(walk(2)) == {} == subject.train_policy()
    assert subject.train_triangular(walk(2)) == {"merging_rate": 0.0, "relaxation_rate": 0.0}
    assert not subject.distance.fits and not subject.agent.trained


# -- line 22 --


def test_d_grows_by_d_last():
    subject, recent = learner(), walk(2, first=6)
    subject.extend_buffer(recent)
    stored = subject.buffer.episodes()
    np.testing.assert_array_equal(stored.observations, concatenate([walk(6), recent]).observations)
    assert not subject.agent.scalings and not subject.distance.calls and not subject.counts.calls


def test_rescaling_happens_when_d_has_doubled_and_reaches_every_part():
    subject = learner(rescale=True)
    subject.extend_buffer(walk(5, first=6))
    assert not subject.agent.scalings
    subject.extend_buffer(walk(1, first=11))
    expected = scaling_of(walk(12))
    (scaling,), (own,) = subject.agent.scalings, subject.distance.asked("rescale")
    assert scaling is own and subject.counts.calls == [("recount", 12, scaling)]
    np.testing.assert_allclose(scaling.observation_mean, expected.observation_mean)
    subject.extend_buffer(walk(11, first=12))
    assert len(subject.agent.scalings) == 1
    subject.extend_buffer(walk(1, first=23))
    assert len(subject.agent.scalings) == 2


def test_scaling_reads_achieved_and_desired_goals_together():
    episodes = walk(3)
    goals = np.concatenate([episodes.achieved_goals.reshape(-1, 1), episodes.desired_goals])
    np.testing.assert_allclose(scaling_of(episodes).goal_mean, goals.mean(0), rtol=1e-5)
    np.testing.assert_allclose(scaling_of(episodes).observation_mean, episodes.observations.mean((0, 1)), rtol=1e-5)
