"""The paper's method trains as it did before there was another: a stored trace, to the bit where it was made.

``data/trace.json`` was written by the revision before method plus. Another processor, torch or MuJoCo rounds otherwise;
there the figures must agree as far as eight iterations carry a rounding.
"""

import hashlib
import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from tiny import learned, tiny

from benchmarks.machine import processor
from napsp.storage.files import read_tensors
from napsp.train import train

STORED = json.loads((Path(__file__).parent / "data" / "trace.json").read_text())


def here():
    """What decides how sums are rounded."""
    return {
        "processor": processor(), "kernels": torch.backends.cpu.get_cpu_capability(), "torch": torch.__version__,
        "mujoco": mujoco.__version__, "numpy": np.__version__,
    }  # fmt: skip


def digest(path):
    """One number for all weights of a model."""
    found = hashlib.sha256()
    for name, tensor in sorted(read_tensors(path, "model")[0].items()):
        found.update(name.encode() + tensor.numpy().tobytes())
    return found.hexdigest()


def test_ours_trains_as_before_plus(tmp_path):
    rows = learned(train(tiny(seed=0), tmp_path))
    assert len(rows) == len(STORED["rows"]) == 3
    for found, stored in zip(rows, STORED["rows"], strict=True):
        for name, value in stored.items():
            assert found[name] == pytest.approx(value, rel=0.02, abs=1e-3, nan_ok=True), name
    if here() == STORED["made_on"]:
        assert [{name: row[name] for name in STORED["rows"][0]} for row in rows] == STORED["rows"]
        assert digest(tmp_path / "model.safetensors") == STORED["weights"]
