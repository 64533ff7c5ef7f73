"""Trainings of a second."""

import hashlib

import numpy as np

from napsp.config import preset
from napsp.data.episodes import FIELDS
from napsp.storage.files import read_tensors
from napsp.storage.resume import stored_episodes, stored_tables
from napsp.storage.state import STATE_FILE

TINY = {
    "n_episodes": 16,
    "n_warmup_episodes": 4,
    "episodes_per_iteration": 2,
    "n_temporal_updates": 3,
    "n_triangular_updates": 2,
    "n_policy_updates": 3,
    "batch_size": 32,
    "hidden": (16, 16),
    "evaluate.every": 4,
    "evaluate.n_episodes": 2,
}


def tiny(env="point_maze", method="ours", recipe="paper", **changes):
    return preset(env, method, recipe, {**TINY, **changes})


def learned(rows):
    """Rows without what depends on the clock."""
    clock = {"seconds", "steps_per_second", "minutes_left"}
    return [{k: v for k, v in row.items() if k not in clock} for row in rows]


def content(folder):
    """Every array of a run's state, wherever it is stored, by name."""
    tensors, header = read_tensors(folder / STATE_FILE, "training state")
    found = {name: tensor.numpy() for name, tensor in tensors.items()} | {"rng": str(header["rng"])}
    found |= {name: getattr(stored_episodes(folder), name) for name in FIELDS}
    for name, table in stored_tables(folder).items():
        found |= {f"{name}.keys": table.keys, f"{name}.counts": table.counts}
    return found


def fingerprint(folder):
    """One number for :func:`content`."""
    digest = hashlib.sha256()
    for name, value in sorted(content(folder).items()):
        digest.update(f"{name} {value if isinstance(value, str) else (value.shape, value.dtype)}".encode())
        digest.update(b"" if isinstance(value, str) else np.ascontiguousarray(value).tobytes())
    return digest.hexdigest()
