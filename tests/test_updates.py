"""A hundred updates of every learner against stored numbers.

The numbers were made by gradients written out by hand, which finite differences had confirmed; autograd must give the
same to rounding.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from napsp.config import preset
from napsp.distance.learned import LearnedDistance
from napsp.distance.network import DistanceConfig
from napsp.execution import Execution
from napsp.policy.agent import PolicyBatch, PolicyConfig
from napsp.policy.ddpg import DDPG
from napsp.policy.sac import SAC

STORED = json.loads((Path(__file__).parent / "data" / "updates.json").read_text())
SIZES, HIDDEN, BATCH, N = (6, 3, 2), (24, 16), 32, 100
CONFIGS = {
    "sac": PolicyConfig(),
    "sac_fixed": PolicyConfig(entropy_weight=0.05, clip_values=False),
    "ddpg": PolicyConfig(agent="ddpg"),
    "ddpg_two": PolicyConfig(agent="ddpg", clipped_double_q=True, action_penalty=0.02, discount=0.9),
}


def fingerprint(network):
    """Four random projections of all parameters."""
    numbers = torch.cat([p.detach().reshape(-1) for p in network.parameters()]).double().numpy()
    return np.random.default_rng(0).standard_normal((4, len(numbers))) @ numbers / np.sqrt(len(numbers))


def batches():
    generator = torch.Generator().manual_seed(3)
    for _ in range(N):
        shapes = (BATCH, 6), (BATCH, 3), (BATCH, 6), (BATCH, 2), (BATCH,)
        draws = torch.randn, torch.rand, torch.randn, torch.randn, torch.rand
        values = [draw(*shape, generator=generator) for draw, shape in zip(draws, shapes, strict=True)]
        yield PolicyBatch(
            values[0], values[1] * 2 - 1, values[2], values[3], -values[4], torch.full((BATCH,), torch.nan)
        )


@pytest.mark.parametrize("name", CONFIGS)
def test_policy_updates_are_those_written_out_by_hand(name):
    torch.manual_seed(1)
    agent = (DDPG if name.startswith("ddpg") else SAC)(SIZES, HIDDEN, CONFIGS[name])
    for network, stored in STORED[name]["start"].items():
        np.testing.assert_allclose(fingerprint(agent.networks()[network]), stored, rtol=1e-6, atol=1e-7)
    generator, rows = torch.Generator().manual_seed(2), []
    for batch in batches():
        rows.append(agent.train(batch, BATCH, generator))  # one update
    for found, stored in zip([*rows[::10], rows[-1]], STORED[name]["rows"], strict=True):
        assert found == pytest.approx(stored, rel=2e-4, abs=1e-6)
    for network, stored in STORED[name]["end"].items():
        np.testing.assert_allclose(fingerprint(agent.networks()[network]), stored, rtol=1e-3, atol=2e-5)


@pytest.mark.parametrize("output", ["linear", "softplus"])
def test_distance_updates_are_those_written_out_by_hand(output):
    stored = STORED["distance" if output == "linear" else "distance_softplus"]
    torch.manual_seed(1)
    learned = LearnedDistance(SIZES, HIDDEN, 50, BATCH, DistanceConfig(output=output), Execution())
    np.testing.assert_allclose(fingerprint(learned.distance), stored["start"], rtol=1e-6, atol=1e-7)
    generator, rows = torch.Generator().manual_seed(4), []
    for i in range(N):
        inputs = torch.randn(BATCH, 11, generator=generator)
        labels = torch.rand(BATCH, generator=generator) * 50
        whole = bool(i % 3)  # a batch of eq. 4a, or the few tuples of eq. 4b that passed
        loss, before = learned.fit(inputs, labels, BATCH) if whole else learned.fit(inputs[:7], labels[:7], BATCH, 0.5)
        if i % 10 == 9:
            learned.update_target()
        rows.append({"loss": float(loss), "prediction": float(before.mean())})
    for found, kept in zip([*rows[::10], rows[-1]], stored["rows"], strict=True):
        assert found == pytest.approx(kept, rel=2e-4)
    np.testing.assert_allclose(fingerprint(learned.distance), stored["end"], rtol=1e-3, atol=2e-5)
    np.testing.assert_allclose(fingerprint(learned.target_distance), stored["target"], rtol=1e-3, atol=2e-5)


def test_alphas_floor_is_the_same_number_of_lost_steps_for_every_method():
    for env, method, floor in (("point_maze", "ours", 0.02), ("point_maze", "sparse", 0.02), ("claw", "ours", 0.025)):
        config = preset(env, method)
        agent = SAC(SIZES, HIDDEN, config.policy, config.lost_step)
        with torch.no_grad():
            agent.log_alpha.fill_(-50.0)
        agent.train(next(batches()), BATCH, torch.Generator())
        assert float(agent.log_alpha.detach().exp()) == pytest.approx(floor)
