"""How updates are run changes rounding alone: compiled, in a CUDA graph, under another scaling."""

import numpy as np
import pytest
import torch
from torch._dynamo.utils import counters
from updates import HIDDEN, SIZES, batch, learned, rows_of

from napsp.compiled import cpp_compiler
from napsp.distance.network import HEADS
from napsp.errors import UserError
from napsp.execution import Execution, GraphedUpdate, Slow, descend, held
from napsp.networks import mlp, rescale
from napsp.policy.actors import Policy
from napsp.policy.agent import PolicyBatch, PolicyConfig
from napsp.policy.ddpg import DDPG
from napsp.policy.sac import SAC
from napsp.scaling import Scaling

needs_compiler = pytest.mark.skipif(cpp_compiler() is None, reason="no C++ compiler")
torch_warns_itself = pytest.mark.filterwarnings("ignore:`torch.jit.script_method` is deprecated")  # in its own import


def test_descending_moves_the_optimisers_own_network_only():
    torch.manual_seed(0)
    policy, critic = mlp(3, (8,), 2), mlp(2, (8,), 1)
    before = [p.clone() for p in critic.parameters()]
    optimizer = Execution().adam(policy.parameters(), 0.1)
    losses = []
    for _ in range(4):
        loss = critic(policy(torch.ones(4, 3))).mean()
        losses.append(float(loss.detach()))
        descend(loss, optimizer)
    assert losses == sorted(losses, reverse=True)
    assert all(torch.equal(p, q) and p.grad is None for p, q in zip(critic.parameters(), before, strict=True))


def test_a_slow_copy_moves_by_its_share():
    for polyak in (0.25, 1.0):
        network = mlp(2, (3,), 1)
        slow = Slow(network, polyak)
        start = [p.clone() for p in slow.network.parameters()]
        assert not any(p.requires_grad for p in slow.network.parameters())
        with torch.no_grad():
            for parameter in network.parameters():
                parameter.add_(torch.randn_like(parameter))
        slow.follow()
        for found, before, fast in zip(slow.network.parameters(), start, network.parameters(), strict=True):
            torch.testing.assert_close(found, (1 - polyak) * before + polyak * fast.detach())


def test_held_parameters_get_no_gradients_and_are_let_go():
    network = mlp(2, (3,), 1)
    parameters, inputs = list(network.parameters()), torch.ones(1, 2, requires_grad=True)
    with pytest.raises(RuntimeError), held(parameters):
        network(inputs).sum().backward()
        assert inputs.grad is not None and all(p.grad is None for p in parameters)
        raise RuntimeError
    assert all(p.requires_grad for p in parameters)


def test_rescaling_inputs_keeps_every_function():
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    first, second = (
        Scaling.estimate(shift + spread * rng.standard_normal((99, 5)), shift + spread * rng.standard_normal((99, 3)))
        for shift, spread in ((1.0, 2.0), (-0.5, 5.0))
    )
    transitions = batch()
    distances = [learned(head=head, n_members=2, unit="step").distance for head in HEADS]
    agents = SAC(SIZES, HIDDEN, PolicyConfig()), DDPG(SIZES, HIDDEN, PolicyConfig(agent="ddpg"))
    for network in (*distances, *(n for agent in agents for n in agent.networks().values())):
        inputs = (transitions.observations, transitions.goals)
        inputs = inputs if isinstance(network, Policy) else (inputs[0], transitions.actions, inputs[1])
        network.scaling.set(first)
        before = network(*inputs).detach()
        rescale(network, second)
        torch.testing.assert_close(network(*inputs).detach(), before, atol=1e-4, rtol=1e-4)
        np.testing.assert_array_equal(network.scaling.numbers().goal_mean, second.goal_mean)


def test_rescaling_parts_reaches_all_their_networks():
    scaling = Scaling(np.full(5, 2.0, np.float32), np.full(5, 3.0, np.float32), *np.ones((2, 3), np.float32))
    for part in (learned(), SAC(SIZES, HIDDEN, PolicyConfig()), DDPG(SIZES, HIDDEN, PolicyConfig())):
        part.rescale(scaling)
        for network in part.networks().values():
            np.testing.assert_array_equal(network.scaling.numbers().observation_scale, 3.0)


@pytest.mark.parametrize("kind", [SAC, DDPG])
def test_a_phase_is_its_batches_one_after_the_other_each_with_noise_of_its_own(kind):
    torch.manual_seed(0)
    whole = kind(SIZES, HIDDEN, PolicyConfig())
    parts = kind(SIZES, HIDDEN, PolicyConfig())
    for name, network in parts.networks().items():
        network.load_state_dict(whole.networks()[name].state_dict())
    scaling = Scaling(np.full(5, 0.5, np.float32), np.full(5, 2.0, np.float32), *np.ones((2, 3), np.float32))
    for network in (*whole.networks().values(), *parts.networks().values()):
        network.scaling.set(scaling)
    transitions, noise = batch(192), torch.randn((2, 192, 2), generator=torch.Generator().manual_seed(7))
    metrics = whole.train(transitions, 64, torch.Generator().manual_seed(7))
    observations, goals = (transitions.observations - 0.5) / 2.0, transitions.goals - 1.0
    following = (transitions.next_observations - 0.5) / 2.0
    scaled = PolicyBatch(observations, transitions.actions, following, goals, transitions.rewards, transitions.ended)
    rows = []
    for k in range(3):
        rows_of_batch = slice(64 * k, 64 * k + 64)
        drawn = (noise[:, rows_of_batch],) if kind is SAC else ()
        rows.append(parts._update(*(part[rows_of_batch] for part in scaled), *drawn))
    for network, wanted in zip(whole.networks().values(), parts.networks().values(), strict=True):
        for parameter, expected in zip(network.parameters(), wanted.parameters(), strict=True):
            torch.testing.assert_close(parameter, expected)
    assert metrics == {name: pytest.approx(np.mean([float(row[name]) for row in rows])) for name in rows[0]}


# -- compiled and captured --


def after_updates(kind, compiled):
    torch.manual_seed(0)
    agent = kind(SIZES, HIDDEN, PolicyConfig(agent=kind.__name__.lower()), execution=Execution(compiled=compiled))
    generator = torch.Generator().manual_seed(3)
    metrics = [agent.train(batch(), 64, generator) for _ in range(3)]
    return agent, metrics[-1]


@pytest.mark.slow
@needs_compiler
@torch_warns_itself
@pytest.mark.parametrize("kind", [SAC, DDPG])
def test_compiled_updates_equal_the_others_to_rounding(kind):
    counters.clear()
    (plain, metrics), (agent, own) = (after_updates(kind, compiled) for compiled in (False, True))
    assert counters["stats"]["unique_graphs"] == 2, "one program per loss, for the whole run"
    assert own == pytest.approx(metrics, rel=1e-4)
    for network, expected in zip(agent.networks().values(), plain.networks().values(), strict=True):
        for parameter, wanted in zip(network.parameters(), expected.parameters(), strict=True):
            torch.testing.assert_close(parameter, wanted, atol=1e-5, rtol=1e-4)


@pytest.mark.slow
@needs_compiler
@torch_warns_itself
def test_compiled_distance_steps_equal_the_others_to_rounding():
    transitions, losses = batch(), []
    rows = rows_of(transitions)
    counters.clear()
    for compiled in (False, True):
        subject = learned(Execution(compiled=compiled))
        subject.fit(rows, 50 * transitions.rewards, n_sampled=64)
        few = subject.fit(rows[:5], 50 * transitions.rewards[:5], n_sampled=64, weight=0.5)  # as of eq. 4b
        losses.append(torch.stack([few[0], subject.fit(rows, 50 * transitions.rewards, n_sampled=64)[0]]))
    assert counters["stats"]["unique_graphs"] == 1
    torch.testing.assert_close(losses[1], losses[0], rtol=1e-4, atol=1e-6)


def test_compiling_without_a_compiler_says_so(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(UserError, match="C\\+\\+ compiler"):
        SAC(SIZES, HIDDEN, PolicyConfig(), execution=Execution(compiled=True))


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has CUDA")
def test_cuda_without_a_device_says_so_and_auto_does_without():
    with pytest.raises(UserError, match="needs a CUDA device"):
        Execution(device="cuda")
    assert Execution(device="auto").torch_device.type == "cpu"


class Recorder:
    """Stands in for torch.cuda where there is none: a graph that replays by calling what was captured."""

    def __init__(self, monkeypatch):
        self.n_replays, self.update = 0, None
        fake = type("Stream", (), {"wait_stream": lambda self, other: None, "__enter__": lambda s: s,
                                   "__exit__": lambda s, *a: None})  # fmt: skip
        monkeypatch.setattr(torch.cuda, "Stream", fake)
        monkeypatch.setattr(torch.cuda, "current_stream", fake)
        monkeypatch.setattr(torch.cuda, "stream", lambda stream: stream)
        monkeypatch.setattr(torch.cuda, "CUDAGraph", lambda: self)
        monkeypatch.setattr(torch.cuda, "graph", lambda graph: fake())

    def replay(self):
        self.n_replays += 1
        self.update()


def test_a_graphed_update_is_captured_once_and_replayed_on_new_numbers(monkeypatch):
    recorder, seen = Recorder(monkeypatch), []
    total, output = torch.zeros(()), torch.zeros(())

    def update(values):
        seen.append(values)

        def run():
            total.add_(values.sum())
            output.copy_(total)

        recorder.update = run
        if not graphed.capturing:
            run()
        return {"total": output}

    class Graphed(GraphedUpdate):
        capturing = False

        def _capture(self, arguments):
            self.capturing = True
            super()._capture(arguments)
            self.capturing = False

    graphed = Graphed(update)
    totals = [float(graphed(torch.full((2,), float(k)))["total"]) for k in range(1, 8)]
    assert totals == [2 * k * (k + 1) / 2 for k in range(1, 8)], "every call is one update, none is lost or doubled"
    assert len(seen) == GraphedUpdate.N_EAGER + 1 and recorder.n_replays == 7 - GraphedUpdate.N_EAGER
    graphed(torch.ones(3))
    assert len(seen) == GraphedUpdate.N_EAGER + 2, "arguments of another shape run as they are"


@pytest.mark.slow
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
@pytest.mark.parametrize("kind", [SAC, DDPG])
def test_updates_on_cuda_equal_those_on_the_cpu(kind):
    results = []
    for device in ("cpu", "cuda"):
        torch.manual_seed(0)
        agent = kind(SIZES, HIDDEN, PolicyConfig(agent=kind.__name__.lower()))
        start = {name: network.state_dict() for name, network in agent.networks().items()}
        moved = kind(SIZES, HIDDEN, PolicyConfig(agent=kind.__name__.lower()), execution=Execution(device=device))
        for name, network in moved.networks().items():
            network.load_state_dict(start[name])
        generator = torch.Generator().manual_seed(3)
        for _ in range(10):
            moved.train(batch(), 64, generator)
        results.append([p.detach().cpu() for p in moved.policy.parameters()])
    for found, wanted in zip(results[1], results[0], strict=True):
        torch.testing.assert_close(found, wanted, atol=1e-4, rtol=1e-3)
