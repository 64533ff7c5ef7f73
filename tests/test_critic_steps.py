"""A sparse critic read as steps says what its values mean."""

import numpy as np
import pytest
import torch
from tiny import tiny

from benchmarks.critic_steps import critic_steps
from napsp.errors import UserError
from napsp.storage.checkpoint import load_model
from napsp.storage.files import read_tensors, write_tensors
from napsp.storage.state import STATE_FILE
from napsp.train import train


@pytest.mark.parametrize("changes", [{}, {"policy.agent": "ddpg", "policy.clipped_double_q": True}])
def test_values_are_read_as_the_steps_they_are_worth(tmp_path, changes):
    """Critics made constant: the worth of 12 lost steps and of more than any episode has; the least counts."""
    train(tiny(method="sparse", **changes), tmp_path)
    model, path = load_model(tmp_path, "point_maze"), tmp_path / STATE_FILE
    discount, length = model.config.policy.discount, 50
    tensors, header = read_tensors(path, "training state")
    for n_lost, expected in ((0, 1), (12, 13), (400, length)):
        worth = [-(1 - discount**n) / (1 - discount) for n in (0, n_lost)]
        for i, value in enumerate(worth):
            tensors[f"critic.nets.{i}.4.weight"].zero_()
            tensors[f"critic.nets.{i}.4.bias"].fill_(value)
        write_tensors(path, tensors, header)
        rows = [np.random.default_rng(0).uniform(size=(5, n)) for n in model.header["sizes"]]
        for actions in (rows[1], None):
            found = critic_steps(tmp_path, model)(rows[0], actions, rows[2])
            np.testing.assert_allclose(found, expected, rtol=1e-4)
    torch.testing.assert_close(tensors["critic.nets.0.4.bias"], torch.zeros(1))


def test_only_a_sparse_run_with_its_state_has_one(tmp_path):
    for method in ("sparse", "offpolicy_ddl"):
        train(tiny(method=method), tmp_path / method)
    model = load_model(tmp_path / "offpolicy_ddl", "point_maze")
    with pytest.raises(UserError, match="offpolicy_ddl"):
        critic_steps(tmp_path / "offpolicy_ddl", model)
    (tmp_path / "sparse" / STATE_FILE).unlink()
    with pytest.raises(UserError, match="train it again"):
        critic_steps(tmp_path / "sparse", load_model(tmp_path / "sparse", "point_maze"))
