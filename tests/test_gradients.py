"""Hand-written gradients equal autograd's; flat parameters stay the networks' own."""

import copy

import numpy as np
import pytest
import torch
from torch._dynamo.utils import counters

from napsp.backprop import Adam, Backprop, flatten
from napsp.compiled import cpp_compiler
from napsp.distance.labels import squared_error
from napsp.distance.regression import DistanceRegression
from napsp.errors import UserError
from napsp.networks import mlp, rescale
from napsp.policy.actors import Policy
from napsp.policy.agent import PolicyBatch
from napsp.policy.ddpg import DDPG
from napsp.policy.sac import SAC, squash
from napsp.presets import preset
from napsp.scaling import Scaling

SIZES = (5, 2, 3)
needs_compiler = pytest.mark.skipif(cpp_compiler() is None, reason="no C++ compiler")
torch_warns_itself = pytest.mark.filterwarnings("ignore:`torch.jit.script_method` is deprecated")  # in its own import


def batch(n=64):
    generator = torch.Generator().manual_seed(1)
    rows = [torch.randn(n, size, generator=generator) for size in (5, 2, 5, 3)]
    return PolicyBatch(rows[0], rows[1].tanh(), rows[2], rows[3], -torch.rand(n, generator=generator))


def config(**changes):
    return preset("point_maze", hidden=(32, 16), batch_size=64, **changes)


def gradients(loss, network):
    return torch.cat([g.reshape(-1) for g in torch.autograd.grad(loss, list(network.parameters()))])


def written(optimizer):
    """The only gradient that an optimiser has seen so far."""
    return optimizer.state["exp_avg"] / 0.1


def noise_like(generator, n_rows=64):
    return torch.randn((2 * n_rows, SIZES[1]), generator=generator)


def test_backprop_equals_autograd():
    torch.manual_seed(0)
    net = mlp(4, (16, 8), 3).double()
    other = mlp(2, (3,), 1).double()
    vector = flatten([other, net])
    inputs = torch.randn(10, 4, dtype=torch.double, requires_grad=True)
    weights = torch.randn(10, 3, dtype=torch.double)
    outputs = net(inputs)
    expected = gradients((outputs * weights).sum(), net)
    (expected_inputs,) = torch.autograd.grad((net(inputs) * weights).sum(), inputs)
    with torch.no_grad():
        backprop = Backprop(net, vector)
        own, tape = backprop.forward(inputs)
        slopes = backprop.slopes(tape, weights)
        torch.testing.assert_close(own, outputs.detach())
        torch.testing.assert_close(torch.cat([g.reshape(-1) for g in backprop.gradients(tape, slopes)]), expected)
        torch.testing.assert_close(backprop.input_slope(slopes, slice(1, 3)), expected_inputs[:, 1:3])


def test_flat_parameters_are_views_and_adam_equals_torch():
    torch.manual_seed(0)
    net = mlp(3, (8,), 2)
    twin = copy.deepcopy(net)
    vector = flatten([net])
    ours, theirs = Adam(vector, 1e-2), torch.optim.Adam(twin.parameters(), lr=1e-2)
    inputs = torch.randn(6, 3)
    for _ in range(20):
        twin.zero_grad()
        twin(inputs).square().sum().backward()
        theirs.step()
        with torch.no_grad():
            backprop = Backprop(net, vector)
            outputs, tape = backprop.forward(inputs)
            ours.update(backprop.gradients(tape, backprop.slopes(tape, 2.0 * outputs)))
    torch.testing.assert_close(net(inputs), twin(inputs))
    net.load_state_dict(copy.deepcopy(net).state_dict())
    assert net[0].weight.data_ptr() == vector.data_ptr()


def test_squared_error_gradient():
    fractions, labels = torch.rand(7, dtype=torch.double, requires_grad=True), torch.rand(7, dtype=torch.double)
    loss, gradient = squared_error(fractions, labels, n_sampled=20)
    torch.testing.assert_close(torch.autograd.grad(loss, fractions)[0], gradient.detach())
    torch.testing.assert_close(loss, ((fractions - labels) ** 2).sum() / 20)


@pytest.mark.parametrize("output", ["linear", "softplus"])
def test_distance_step_is_the_gradient_of_the_mean_squared_error_in_units_of_t(output):
    torch.manual_seed(0)
    regression = DistanceRegression(SIZES, config(distance_output=output))
    rows = batch()
    inputs = torch.cat([rows.observations, rows.actions, rows.goals], dim=1)
    labels = 50 * torch.rand(64)
    predictions = regression.distance(rows.observations, rows.actions, rows.goals)
    expected = gradients(0.5 * ((predictions - labels) / 50).square().mean(), regression.distance)
    loss, own = regression.fit(inputs, labels, n_sampled=64, weight=0.5)
    torch.testing.assert_close(own, predictions.detach())
    torch.testing.assert_close(loss, ((predictions.detach() - labels) / 50).square().mean())
    torch.testing.assert_close(written(regression.optimizer), expected, atol=1e-7, rtol=1e-4)


def test_sac_gradients_equal_autograd():
    torch.manual_seed(0)
    agent, rows = SAC(SIZES, config()), batch()
    with torch.no_grad():  # large log deviations, so that the clamp is met too
        agent.policy.net[-1].bias[2:] += torch.tensor([3.0, -1.0])
    before = {name: copy.deepcopy(network) for name, network in agent.networks().items()}
    alpha, generator = agent.log_alpha.exp(), torch.Generator().manual_seed(5)
    agent.update(rows, torch.Generator().manual_seed(5))

    policy, critic, target = (before[name] for name in ("policy", "critic", "target_critic"))
    states = torch.cat([rows.next_observations, rows.observations])
    actions, log_density, *_ = squash(policy(states, rows.goals.repeat(2, 1)), noise_like(generator))
    (next_actions, actions), (next_log_density, log_density) = actions.chunk(2), log_density.chunk(2)
    with torch.no_grad():
        values = target(rows.next_observations, next_actions, rows.goals).amin(0) - alpha * next_log_density
        targets = (rows.rewards + 0.98 * values).clamp(-50.0, 0.0)
    loss = (critic(rows.observations, rows.actions, rows.goals) - targets).square().mean(1).sum()
    torch.testing.assert_close(
        written(agent.optimizers["critic_optimizer"]), gradients(loss, critic), atol=1e-6, rtol=1e-3
    )

    values = agent.critic(rows.observations, actions, rows.goals).amin(0)
    expected = gradients((alpha * log_density - values).mean(), policy)
    torch.testing.assert_close(written(agent.optimizers["policy_optimizer"]), expected, atol=1e-6, rtol=1e-3)
    torch.testing.assert_close(written(agent.optimizers["alpha_optimizer"]), -(log_density.mean().detach() - 2.0))
    moved = [p + 0.01 * (q - p) for p, q in zip(target.parameters(), agent.critic.parameters(), strict=True)]
    for own, wanted in zip(agent.target_critic.parameters(), moved, strict=True):
        torch.testing.assert_close(own, wanted.detach())


@pytest.mark.parametrize("clipped_double_q", [False, True])
def test_ddpg_gradients_equal_autograd(clipped_double_q):
    torch.manual_seed(0)
    changes = {"agent": "ddpg", "action_penalty": 0.7, "clipped_double_q": clipped_double_q}
    agent, rows = DDPG(SIZES, config(**changes)), batch()
    before = {name: copy.deepcopy(network) for name, network in agent.networks().items()}
    agent.update(rows, torch.Generator())

    policy, critic = before["policy"], before["critic"]
    with torch.no_grad():
        next_actions = before["target_policy"].mode(rows.next_observations, rows.goals)
        values = before["target_critic"](rows.next_observations, next_actions, rows.goals)
        assert len(values) == 1 + clipped_double_q
        targets = (rows.rewards + 0.98 * values.amin(0)).clamp(-50.0, 0.0)
    errors = critic(rows.observations, rows.actions, rows.goals) - targets
    loss = errors.square().mean(1).sum()
    torch.testing.assert_close(
        written(agent.optimizers["critic_optimizer"]), gradients(loss, critic), atol=1e-6, rtol=1e-3
    )

    actions = policy.mode(rows.observations, rows.goals)
    loss = -agent.critic(rows.observations, actions, rows.goals)[0].mean() + 0.7 * actions.square().mean()
    torch.testing.assert_close(
        written(agent.optimizers["policy_optimizer"]), gradients(loss, policy), atol=1e-6, rtol=1e-3
    )
    assert not torch.equal(agent.target_policy.net[0].weight, policy.net[0].weight)


def test_rescaling_inputs_keeps_every_function():
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    first, second = (
        Scaling.estimate(shift + spread * rng.standard_normal((99, 5)), shift + spread * rng.standard_normal((99, 3)))
        for shift, spread in ((1.0, 2.0), (-0.5, 5.0))
    )
    rows = batch()
    for agent in (SAC(SIZES, config()), DDPG(SIZES, config(agent="ddpg"))):
        for network in (*agent.networks().values(), DistanceRegression(SIZES, config()).distance):
            inputs = (rows.observations, rows.goals)
            inputs = inputs if isinstance(network, Policy) else (inputs[0], rows.actions, inputs[1])
            network.scaling.set(first)
            before = network(*inputs).detach()
            rescale(network, second)
            torch.testing.assert_close(network(*inputs).detach(), before, atol=1e-5, rtol=1e-4)
            np.testing.assert_array_equal(network.scaling.numbers().goal_mean, second.goal_mean)


def after_updates(agent_class, **changes):
    torch.manual_seed(0)
    agent, generator = agent_class(SIZES, config(**changes)), torch.Generator().manual_seed(3)
    metrics = [agent.update(batch(), generator) for _ in range(3)]
    return agent, {k: float(v) for k, v in metrics[-1].items()}


@pytest.mark.slow
@needs_compiler
@torch_warns_itself
@pytest.mark.parametrize("agent_class", [SAC, DDPG])
def test_compiled_updates_equal_the_others_to_rounding(agent_class):
    name = agent_class.__name__.lower()
    counters.clear()
    (plain, metrics), (agent, own) = (after_updates(agent_class, agent=name, compiled=c) for c in (False, True))
    assert counters["stats"]["unique_graphs"] == 1
    assert own == pytest.approx(metrics, rel=1e-4)
    for network, expected in zip(agent.networks().values(), plain.networks().values(), strict=True):
        for parameter, wanted in zip(network.parameters(), expected.parameters(), strict=True):
            torch.testing.assert_close(parameter, wanted, atol=1e-5, rtol=1e-4)


@pytest.mark.slow
@needs_compiler
@torch_warns_itself
def test_compiled_distance_steps_equal_the_others_to_rounding():
    rows, losses = batch(), []
    counters.clear()
    inputs = torch.cat([rows.observations, rows.actions, rows.goals], dim=1)
    for compiled in (False, True):
        torch.manual_seed(0)
        regression = DistanceRegression(SIZES, config(compiled=compiled))
        regression.fit(inputs, 50 * rows.rewards, n_sampled=64)
        few = regression.fit(inputs[:5], 50 * rows.rewards[:5], n_sampled=64, weight=0.5)  # as of eq. 4b
        losses.append(torch.stack([few[0], regression.fit(inputs, 50 * rows.rewards, n_sampled=64)[0]]))
    assert counters["stats"]["unique_graphs"] == 1
    torch.testing.assert_close(losses[1], losses[0], rtol=1e-4, atol=1e-6)


def test_compiling_without_a_compiler_says_so(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(UserError, match="C\\+\\+ compiler"):
        DistanceRegression(SIZES, config(compiled=True))
