"""Quasimetric RL: its losses against their formulas, its multipliers, and a corridor whose distances are known."""

import numpy as np
import pytest
import torch
from scipy.stats import spearmanr
from test_descent import LENGTH, SIZES, batch_of
from torch.nn.functional import softplus

from napsp.config import preset
from napsp.data.episodes import Episodes
from napsp.distance.learned import LearnedDistance
from napsp.distance.network import DistanceConfig
from napsp.errors import UserError
from napsp.execution import Execution
from napsp.parts import build_learner
from napsp.policy.qrl import QRL, distance_loss, policy_loss


def qrl(sizes=SIZES, **changes):
    torch.manual_seed(0)
    config = preset("fetch_wall", "qrl", changes={"hidden": (16, 16), **changes})
    distance = LearnedDistance(sizes, config.hidden, LENGTH, 8, config.distance, Execution())
    return QRL(sizes, config.hidden, config.policy, config.qrl, distance)


def test_the_loss_pushes_apart_and_holds_steps_arrivals_and_dynamics():
    agent, batch = qrl(**{"qrl.multiplier": 3.0}), batch_of(8, arrived=torch.arange(8) < 3)
    with torch.no_grad():
        for parameter in agent.learned.distance.parameters():
            parameter.add_(0.3 * torch.randn(parameter.shape))
        expected, violations = 0.0, []
        for head in agent.heads:
            z, y, h = head.observation(batch.observations), head.observation(batch.next_observations), head.goal
            push = softplus(15 - head.distance(z, h(batch.next_achieved.roll(1, 0))), beta=0.1).mean()
            step = (head.distance(z, y) - 1).clamp(min=0).pow(2).mean()
            own = head.distance(y, h(batch.next_achieved)).pow(2).mean()
            wanted = head.distance(y, h(batch.goals))[:3].pow(2).mean()
            p = z + head.dynamics(torch.cat([z, batch.actions], 1))
            dynamics = 0.5 * (head.distance(p, y).pow(2) + head.distance(y, p).pow(2)).mean()
            violations.append(step + own + wanted - 0.0625)
            expected = expected + push + 3.0 * violations[-1] + 0.1 * dynamics
    loss, found, _ = distance_loss(agent, batch)
    torch.testing.assert_close(loss.detach(), expected)
    torch.testing.assert_close(found, torch.stack(violations))
    loss.backward()
    assert all(p.grad is None for p in [*agent.policy.parameters(), agent.multipliers])


def test_the_policy_descends_the_largest_distance():
    agent, batch = qrl(**{"policy.action_penalty": 0.5}), batch_of(8)
    action = agent.policy.mode(batch.observations, batch.goals)
    rows = torch.cat([batch.observations, action, batch.goals], 1)
    steps = (LENGTH * agent.learned.distance.members(rows)).amax(0)
    assert (steps >= 1).all()
    torch.testing.assert_close(policy_loss(agent, batch), steps.mean() + 0.5 * action.square().mean())


def test_a_multiplier_grows_while_its_constraint_is_violated_and_shrinks_else():
    for tolerance, grows in ((1e-3, True), (1e3, False)):
        agent = qrl(**{"qrl.tolerance": tolerance})
        before = agent.multipliers.detach().clone()
        agent.train(batch_of(32), 8, torch.Generator())
        assert ((agent.multipliers > before) == grows).all()


def test_the_head_belongs_to_the_method():
    with pytest.raises(UserError, match="in steps"):
        DistanceConfig(head="latent")
    for method, changes in (("qrl", {"distance.head": "mlp"}), ("plus", {"distance.head": "latent"})):
        with pytest.raises(UserError, match="qrl"):
            preset("point_maze", method, changes=changes)
    with pytest.raises(TypeError, match="latent"):
        config = preset("point_maze", "plus")
        QRL(SIZES, (8,), config.policy, config.qrl, LearnedDistance(SIZES, (8,), 50, 8, config.distance, Execution()))


@pytest.mark.slow
def test_on_a_corridor_it_finds_the_distances_and_the_way():
    """s in [0, 20], s' = s + a, goals within half a step: d = |s + a - g| + 1 where that is more than one step."""
    rng = np.random.default_rng(0)
    places = np.empty((40, LENGTH + 1, 1), np.float32)
    places[:, 0, 0], actions = rng.uniform(0, 20, 40), rng.uniform(-1, 1, (40, LENGTH, 1)).astype(np.float32)
    for t in range(LENGTH):
        places[:, t + 1] = np.clip(places[:, t] + actions[:, t], 0, 20)
    episodes = Episodes(places, places.copy(), actions, places[rng.permutation(40), -1])
    changes = {"hidden": (64, 64), "n_policy_updates": 400, "batch_size": 128, "graph.every": 0,
               "distance.learning_rate": 1e-3, "policy.learning_rate": 1e-3, "qrl.multiplier": 3.0,
               "qrl.multiplier_learning_rate": 0.1}  # of 400 updates  # fmt: skip
    config = preset("fetch_wall", "qrl", changes=changes)
    torch.manual_seed(0)
    at_goal = lambda achieved, goals: -(np.abs(achieved - goals)[:, 0] > 0.5).astype(np.float32)  # noqa: E731
    learner = build_learner(config, (1, 1, 1), episodes, at_goal, rng, torch.Generator())
    metrics = learner.train_jointly()
    assert np.isfinite(list(metrics.values())).all()
    s, g = rng.uniform(1, 19, (2, 500, 1)).astype(np.float32)
    s, g = s[abs(s - g)[:, 0] > 2], g[abs(s - g)[:, 0] > 2]
    a = rng.uniform(-1, 1, s.shape).astype(np.float32)
    found = learner.distance.steps(learner.distance.rows(s, a, g)).numpy()
    assert spearmanr(found, np.abs(s + a - g)[:, 0]).statistic > 0.97
    chosen = learner.agent.policy.mode(torch.from_numpy(s), torch.from_numpy(g)).detach().numpy()
    assert (np.sign(chosen) == np.sign(g - s)).mean() > 0.95
