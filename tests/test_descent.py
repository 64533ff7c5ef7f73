"""Method plus: labels, who is asked, who learns."""

import numpy as np
import pytest
import torch
from test_learner import learner, reward, walk

from napsp.compiled import cpp_compiler
from napsp.config import preset
from napsp.data.episodes import Episodes
from napsp.distance.labels import BootstrapConfig, one_step_label
from napsp.distance.learned import LearnedDistance
from napsp.errors import UserError
from napsp.execution import Execution
from napsp.parts import build_learner
from napsp.policy.descent import Descent, DescentBatch, distance_loss, policy_loss
from napsp.policy.her import HERConfig, sample_relabelled
from napsp.scaling import Scaling

SIZES, LENGTH = (3, 2, 2), 50
NAN, INF = float("nan"), float("inf")


def test_a_label_is_the_least_of_what_is_known():
    arrived = torch.tensor([True, False, False, False, False, False, False])
    next_steps = torch.tensor([20.0, 20.0, 20.0, 20.0, 80.0, -3.0, 20.0])
    observed = torch.tensor([INF, INF, 7.0, INF, INF, INF, 7.0])
    known = torch.tensor([30.0, NAN, NAN, 12.0, NAN, NAN, 12.0])
    found = one_step_label(arrived, next_steps, observed, known, LENGTH)
    assert found.tolist() == [1, 21, 7, 12, 50, 2, 7]


def test_an_arrival_that_does_not_last_costs_a_share_of_the_way_back():
    arrived, rest = torch.tensor([True, True, True, True, False]), torch.full((5,), INF)
    next_steps = torch.tensor([0.5, 1.0, 5.0, 99.0, 5.0])
    found = [one_step_label(arrived, next_steps, rest, rest * NAN, LENGTH, stay).tolist() for stay in (0.0, 0.5, 1.0)]
    assert found == [[1, 1, 1, 1, 6], [1, 1, 3, 25.5, 6], [1, 1, 5, 50, 6]]


def test_pessimism_is_over_the_networks():
    members = torch.tensor([[1.0, 8.0], [3.0, 4.0]])
    expected = {"largest": [3, 8], "mean": [2, 6], "smallest": [1, 4]}
    assert {name: BootstrapConfig(name).reduce(members).tolist() for name in expected} == expected


def test_only_a_goal_of_the_same_episodes_future_has_observed_steps():
    episodes = walk(6)
    drawn = sample_relabelled(episodes, 4000, HERConfig(0.4, 0.5), reward, np.random.default_rng(0))
    own = np.isfinite(drawn.steps_between)
    assert 0.37 < own.mean() < 0.43
    np.testing.assert_array_equal(drawn.steps_between[own], (drawn.goals - drawn.observations)[own, 0])
    np.testing.assert_array_equal(drawn.next_achieved, drawn.next_observations)  # here phi(s) = s


def test_what_comes_after_a_future_goal_is_the_episodes_next_state():
    episodes = walk(6)
    drawn = sample_relabelled(episodes, 4000, HERConfig(0.4, 0.5), reward, np.random.default_rng(0))
    known = np.isfinite(drawn.after[:, 0])
    at_the_end = drawn.goals[:, 0] % 1000 == episodes.actions.shape[1]
    np.testing.assert_array_equal(known, np.isfinite(drawn.steps_between) & ~at_the_end)
    np.testing.assert_array_equal(drawn.after[known], drawn.goals[known] + 1)


@pytest.mark.parametrize("waits", [True, False])
def test_where_arrivals_should_last_only_those_that_did_bound_a_label(waits):
    """One who walks on is nowhere two steps long; one who waits at 10 has lasting arrivals there alone."""
    subject = learner("plus", everything=walk(6, waits=waits), **{"n_policy_updates": 8})
    subject.lasting, handed = True, []
    subject.agent.train = lambda batch, size, generator: handed.append(batch) or {}
    subject.train_jointly()
    bounded = handed[0].observed.isfinite()
    assert bool(bounded.any()) is waits
    assert (handed[0].goals[bounded] % 1000 == 10).all()


def test_arrivals_should_last_where_actions_do_not_decide_at_once():
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (20, 10, 2)).astype(np.float32)
    moved = np.concatenate([np.zeros((20, 1, 2)), actions.cumsum(1)], 1).astype(np.float32)
    pushed = np.concatenate([np.zeros((20, 2, 2)), actions.cumsum(1).cumsum(1)[:, :-1]], 1).astype(np.float32)
    for places, lasting, stay in ((moved, False, 0.5), (pushed, True, 0.5), (pushed, False, 0.0)):
        config = preset("point_maze", "plus", changes={"hidden": (8,), "bootstrap.stay": stay})
        episodes = Episodes(np.concatenate([places, places[..., :1]], 2), places, actions, places[:, 0])
        built = build_learner(config, SIZES, episodes, reward, rng, torch.Generator())
        assert built.lasting is lasting and built.agent.bootstrap.stay == (stay if lasting else 0)
        assert (built.graph is not None) is (places is moved)


class KnowsSome:
    """A graph that knows the way to goals of even episodes: 30 steps."""

    def __init__(self):
        self.built = []

    def build(self, episodes, seed):
        self.built.append((len(episodes), seed))
        self.n_cells, self.connected = 5, 0.5

    def steps(self, achieved, goals):
        return np.where(goals[:, 0] // 1000 % 2 == 0, 30.0, np.nan).astype(np.float32) + 0 * achieved[:, 0]


def test_without_updates_nothing_is_trained():
    assert learner("plus", n_policy_updates=0).train_jointly() == {}


def test_the_policys_learner_cannot_be_chosen():
    with pytest.raises(UserError, match="policy of its own"):
        preset("point_maze", "plus", changes={"policy.agent": "sac"})


def test_what_a_method_does_not_ask_for_is_no_difference():
    for method, idle in (("ours", {"graph.cell": 2.0, "bootstrap.bound": False}), ("plus", {"policy.discount": 0.5})):
        assert preset("point_maze", method, changes=idle).digest() == preset("point_maze", method).digest()
        other = "plus" if method == "ours" else "ours"
        assert preset("point_maze", other, changes=idle).digest() != preset("point_maze", other).digest()


@pytest.mark.parametrize("bound", [True, False])
def test_the_learner_hands_over_what_is_known_of_a_transition(bound):
    subject = learner("plus", **{"n_policy_updates": 8, "bootstrap.bound": bound})
    subject.graph, handed = KnowsSome(), []
    subject.agent.train = lambda batch, size, generator: handed.append((batch, size)) or {"loss": 1.0}
    metrics = subject.train_jointly()
    ((batch, size),) = handed
    assert size == 64 and len(batch.goals) == 8 * 64
    torch.testing.assert_close(batch.arrived, (batch.next_observations - batch.goals)[:, 0].abs() <= 0.5)
    assert batch.arrived.any() and not batch.arrived.all()
    even = (batch.goals[:, 0] // 1000) % 2 == 0
    torch.testing.assert_close(batch.known.isfinite(), even)
    assert (batch.known[even] == 31).all(), "a step more than from the next state"
    assert bool(batch.observed.isfinite().any()) is bound
    assert metrics == {"loss": 1.0, "known": pytest.approx(float(even.float().mean()))}
    assert not subject.distance.calls and not subject.counts.calls


def test_the_graph_is_searched_now_and_then():
    subject = learner("plus", **{"graph.every": 3, "seed": 7})
    assert subject.search_graph(0) == {}, "no graph, nothing to search"
    subject.graph = KnowsSome()
    for iteration in range(7):
        assert subject.search_graph(iteration) == {"n_cells": 5.0, "connected": 0.5}
    assert subject.graph.built == [(6, 7)] * 3


def descent(execution=None, **changes):
    torch.manual_seed(0)
    config = preset("fetch_wall", "plus", changes={"hidden": (16, 16), **changes})
    distance = LearnedDistance(SIZES, config.hidden, LENGTH, 8, config.distance, execution or Execution())
    return Descent(SIZES, config.hidden, config.policy, config.bootstrap, distance, config.distance.loss, execution)


def batch_of(n, seed=0, **changes):
    generator = torch.Generator().manual_seed(seed)
    rows = [torch.randn(n, size, generator=generator) for size in (3, 2, 3, 2)]
    changes = {"next_achieved": torch.randn(n, 2, generator=generator), **changes}
    known = {"arrived": torch.zeros(n, dtype=torch.bool), "observed": torch.full((n,), INF)}
    nowhere = {"known": torch.full((n,), NAN), "ended": torch.full((n,), NAN)}
    return DescentBatch(*rows, **{**known, **nowhere, **changes})


def test_labels_bootstrap_from_the_slow_networks_at_the_slow_policys_action():
    agent, batch = descent(), batch_of(8)
    with torch.no_grad():
        for network in (agent.target_distance, agent.target_policy):
            for parameter in network.parameters():
                parameter.add_(0.3 * torch.randn(parameter.shape))
        for head in agent.target_distance.heads:
            head.net[-1].bias += 8.0  # steps
        action = agent.target_policy.mode(batch.next_observations, batch.goals)
        inputs = torch.cat([batch.next_observations, action, batch.goals], 1)
        labels = (1 + LENGTH * agent.target_distance.members(inputs).amax(0)).clamp(2, LENGTH)
        assert len(labels.unique()) == 8
        predicted = LENGTH * agent.distance.members(torch.cat([batch.observations, batch.actions, batch.goals], 1))
        expected = (10 / (labels + 5) * ((predicted - labels) / LENGTH) ** 2).sum() / 8
    loss, metrics = distance_loss(agent, batch)
    torch.testing.assert_close(loss, expected)
    torch.testing.assert_close(metrics["mean_label"], labels.mean())
    loss.backward()
    assert all(p.grad is None for p in [*agent.policy.parameters(), *agent.target_distance.parameters()])


def test_the_policy_descends_the_first_distance():
    agent, batch = descent(**{"policy.action_penalty": 0.5}), batch_of(8)
    action = agent.policy.mode(batch.observations, batch.goals)
    steps = agent.distance.members(torch.cat([batch.observations, action, batch.goals], 1))[0] * LENGTH
    torch.testing.assert_close(policy_loss(agent, batch), steps.mean() + 0.5 * action.square().mean())


def test_training_fits_what_is_known_and_the_policy_goes_downhill():
    """d = 10 + 10 a_0 wherever one looks: it is learned, and the policy turns to a_0 = -1."""
    agent, batch = descent(**{"policy.learning_rate": 3e-3}), batch_of(4096)
    batch = batch._replace(actions=batch.actions.tanh())
    batch = batch._replace(known=10.0 + 10.0 * batch.actions[:, 0])
    before = {name: p.clone() for net in agent.networks().values() for name, p in net.named_parameters()}
    for _ in range(12):
        figures = agent.train(batch, 64, torch.Generator())
    assert figures["mean_label"] == pytest.approx(float(batch.known.clamp(2, LENGTH).mean()), rel=1e-4)
    steps = agent.distance.steps(batch.observations, batch.actions, batch.goals)
    assert float((steps - batch.known.clamp(min=2)).detach().abs().mean()) < 1.0
    assert float(agent.policy.mode(batch.observations, batch.goals)[:, 0].detach().mean()) < -0.8
    assert any(not torch.equal(p, before[name]) for name, p in agent.target_policy.named_parameters())


def test_rescaling_reaches_all_its_networks():
    scaling = Scaling(np.full(3, 2.0, np.float32), np.full(3, 3.0, np.float32), *np.ones((2, 2), np.float32))
    agent = descent()
    agent.rescale(scaling)
    agent.learned.rescale(scaling)
    for network in (*agent.networks().values(), *agent.learned.networks().values()):
        np.testing.assert_array_equal(network.scaling.numbers().observation_scale, 3.0)


def test_a_phase_is_its_scaled_batches_one_after_the_other():
    whole, parts, raw = descent(), descent(), batch_of(24)
    scaling = Scaling(np.full(3, 0.5, np.float32), np.full(3, 2.0, np.float32), *np.ones((2, 2), np.float32))
    for agent in (whole, parts):
        for network in (*agent.networks().values(), *agent.learned.networks().values()):
            network.scaling.set(scaling)
    figures = whole.train(raw, 8, torch.Generator())
    scaled = raw._replace(
        observations=(raw.observations - 0.5) / 2.0, next_observations=(raw.next_observations - 0.5) / 2.0,
        goals=raw.goals - 1.0,
    )  # fmt: skip
    rows = [parts._update(*(part[8 * k : 8 * k + 8] for part in scaled)) for k in range(3)]
    assert figures == {name: pytest.approx(np.mean([float(row[name]) for row in rows])) for name in rows[0]}
    for mine, other in ((whole.policy, parts.policy), (whole.target_distance, parts.target_distance)):
        torch.testing.assert_close(mine.state_dict(), other.state_dict())


@pytest.mark.slow
@pytest.mark.skipif(cpp_compiler() is None, reason="no C++ compiler")
@pytest.mark.filterwarnings("ignore:`torch.jit.script_method` is deprecated")
def test_compiled_it_learns_the_same():
    agents = [descent(), descent(execution=Execution(compiled=True))]
    for agent in agents:
        agent.train(batch_of(64), 16, torch.Generator())
    torch.testing.assert_close(*(agent.distance.state_dict() for agent in agents), atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(*(agent.policy.state_dict() for agent in agents), atol=1e-5, rtol=1e-4)


@pytest.mark.slow
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
def test_on_cuda_it_learns_the_same():
    """Both ways of training d: with the policy, as a graph from the fourth update on, and by labels alone."""
    agents = [descent(), descent(execution=Execution("cuda"))]
    rng = np.random.default_rng(1)
    for _ in range(8):
        seen = [rng.normal(size=(8, size)).astype(np.float32) for size in SIZES]
        for agent in agents:
            agent.train(batch_of(16), 8, torch.Generator())
            rows = agent.learned.rows(*seen)
            agent.learned.fit(rows, agent.learned.steps(rows) + 1.0, n_sampled=8)
    networks = [{**agent.networks(), **agent.learned.networks()} for agent in agents]
    for name, network in networks[0].items():
        for found, expected in zip(networks[1][name].parameters(), network.parameters(), strict=True):
            torch.testing.assert_close(found.cpu(), expected, atol=1e-4, rtol=1e-3, msg=name)
