"""Heads of d and losses: each learns labels, each is what its formula says."""

import sys

import pytest
import torch
from updates import HIDDEN, SIZES, batch, learned, rows_of

from napsp.distance.losses import LOSSES, Labelled
from napsp.distance.network import DistanceNetwork
from napsp.distance.quasimetric import interval_lengths
from napsp.execution import Execution, descend
from napsp.policy.agent import PolicyConfig
from napsp.policy.ddpg import DDPG
from napsp.policy.sac import SAC


@pytest.mark.parametrize(
    "options", [{}, {"layer_norm": True}, {"n_members": 3}, {"head": "quasimetric"}, {"output": "softplus"},
                {"head": "quasimetric", "n_members": 2, "layer_norm": True}],
)  # fmt: skip
def test_every_head_learns_labels_and_the_losses_need_not_know_which(options):
    subject, rows = learned(learning_rate=3e-3, **options), rows_of(batch())
    labels = 5.0 + 40.0 * torch.rand(64, generator=torch.Generator().manual_seed(0))
    first = float(subject.fit(rows, labels, 64)[0])
    for _ in range(300):
        loss, predictions = subject.fit(rows, labels, 64)
    assert float(loss) < 0.1 * first and predictions.shape == (64,)
    torch.testing.assert_close(subject.steps(rows), subject.distance.fractions(rows).detach().clamp(0, 1) * 50)
    assert not torch.equal(subject.target_steps(rows), subject.steps(rows))
    assert (not subject.distance.plain()) == bool(options.keys() & {"head", "layer_norm"})


def test_members_are_fitted_on_their_own():
    subject, rows = learned(n_members=2), rows_of(batch())
    alone = DistanceNetwork(SIZES, HIDDEN, 50)
    alone.heads[0].load_state_dict(subject.distance.heads[1].state_dict())
    optimizer = Execution().adam(alone.parameters(), 1e-3)
    labels = 50 * torch.rand(64, generator=torch.Generator().manual_seed(0))
    for _ in range(5):
        subject.fit(rows, labels, 64)
        descend(LOSSES["squared"](alone, Labelled(rows, labels, 64))[0], optimizer)
    torch.testing.assert_close(subject.distance.members(rows)[1], alone.fractions(rows), atol=1e-6, rtol=1e-4)


@pytest.mark.parametrize(
    ("loss", "weights"),
    [("squared", torch.ones_like), ("relative", lambda labels: 10.0 / (labels + 5.0))],
)
def test_a_loss_is_the_weighted_sum_of_the_members_squared_errors_in_units_of_t(loss, weights):
    subject, rows = learned(n_members=2), rows_of(batch())
    labels = 50 * torch.rand(64, generator=torch.Generator().manual_seed(0))
    members = subject.distance.members(rows).detach()
    value, metrics = LOSSES[loss](subject.distance, Labelled(rows, labels, 100))
    torch.testing.assert_close(value.detach(), (weights(labels) * (members - labels / 50) ** 2).sum() / 100)
    torch.testing.assert_close(metrics["predictions"], 50 * (members[0] + members[1]) / 2)
    assert value.requires_grad and not metrics["predictions"].requires_grad


@pytest.mark.parametrize("kind", [SAC, DDPG])
def test_the_critics_loss_adds_up_the_critics_mean_squared_errors(kind):
    torch.manual_seed(0)
    agent = kind(SIZES, HIDDEN, PolicyConfig(clipped_double_q=True, discount=0.0, clip_values=False))
    transitions = batch(32)
    noise = (torch.zeros(32, 2), torch.zeros(())) if kind is SAC else ()
    loss, metrics = sys.modules[kind.__module__].critic_loss(agent, transitions, *noise)
    values = agent.critic.values(transitions.observations, transitions.actions, transitions.goals).detach()
    errors = (values - transitions.rewards) ** 2  # without a future the target is the reward
    torch.testing.assert_close(loss.detach(), errors[0].mean() + errors[1].mean())
    torch.testing.assert_close(metrics["critic_loss"], errors[1].mean() if kind is SAC else errors.mean())
    assert agent.tensors() == ({"log_alpha": agent.log_alpha} if kind is SAC else {})


def test_interval_lengths_are_a_quasimetric():
    generator = torch.Generator().manual_seed(0)
    x, y, z = torch.randn(3, 500, 6, generator=generator)
    there, on, through = interval_lengths(x, y), interval_lengths(y, z), interval_lengths(x, z)
    assert (through <= there + on + 1e-5).all() and (there >= 0).all()
    assert not interval_lengths(x, x).any() and (there != interval_lengths(y, x)).any()
    points = torch.linspace(-5, 5, 20_001)[:, None]
    for a, b in zip(x[:20], y[:20], strict=True):
        covered = ((points >= a) & (points < torch.maximum(a, b))).any(1).float().mean() * 10.0
        torch.testing.assert_close(interval_lengths(a, b), covered, atol=5e-3, rtol=0)


def test_a_new_loss_is_a_function_and_a_line(monkeypatch):
    def absolute(distance, labelled):
        errors = (distance.members(labelled.rows) - labelled.labels / distance.episode_length).abs()
        return errors.sum() / labelled.n_sampled, {"predictions": distance.fractions(labelled.rows).detach() * 50}

    monkeypatch.setitem(LOSSES, "absolute", absolute)
    subject, rows = learned(loss="absolute", learning_rate=3e-3), rows_of(batch())
    labels = torch.where(rows[:, 0] > 0, 40.0, 10.0)
    losses = [float(subject.fit(rows, labels, 64)[0]) for _ in range(200)]
    assert losses[-1] < 0.3 * losses[0]
