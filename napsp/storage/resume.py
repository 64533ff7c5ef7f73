"""The whole state of a training run on disk, so that a killed run goes on where it was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from napsp.config import ADDED, SPEED_ONLY, TrainConfig
from napsp.data.episodes import FIELDS, Episodes
from napsp.errors import UserError
from napsp.learner import Learner
from napsp.storage.files import FORMAT, read_tensors, write_tensors

STATE_FILE = "training_state.safetensors"


def save_training(path: Path, learner: Learner, iteration: int, seconds: float, revisions: list[str]) -> None:
    """Write networks, optimisers, counts, D and random states after ``iteration`` iterations."""
    tensors: dict[str, Tensor] = {"torch_generator": learner.generator.get_state()}
    for name, network in learner.networks().items():
        tensors |= {f"{name}.{key}": value for key, value in network.state_dict().items()}
    for name, optimizer in learner.optimizers().items():
        tensors |= {f"{name}.0.{key}": value for key, value in optimizer.state.items()}
    tensors |= {f"agent.{name}": value for name, value in learner.agent.tensors().items()}
    for name, array in _arrays(learner).items():
        tensors[name] = torch.from_numpy(np.ascontiguousarray(array))
    header = {
        "format": FORMAT,
        "kind": "training state",
        "config": learner.config.to_dict(),
        "iteration": iteration,
        "seconds": seconds,
        "scaled_at": learner.scaled_at,
        "revisions": revisions,
        "rng": learner.rng.bit_generator.state,
    }
    write_tensors(path, tensors, header)


def read_training(path: Path, config: TrainConfig) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read a training state and check that it belongs to ``config``.

    The number of episodes may differ: a finished run can be prolonged. So may what only speed depends on.

    Raises:
        UserError: damaged file, or a run with other settings.
    """
    try:
        tensors, header = read_tensors(path, "training state")
    except UserError as error:
        raise UserError(f"{error}, or begin anew with --restart") from None
    saved, wanted = {**ADDED, **header["config"]}, config.to_dict()
    different = [name for name in wanted if name not in ("n_episodes", *SPEED_ONLY) and saved.get(name) != wanted[name]]
    if different:
        raise UserError(
            f"{path.parent} holds a run with other settings ({', '.join(different)}); "
            "choose another --out, or --restart to overwrite it"
        )
    return tensors, header


def warmup_episodes(tensors: dict[str, Tensor], config: TrainConfig) -> Episodes:
    """The warm-up episodes: the first ones of the stored D."""
    n = -(-config.n_warmup_episodes // config.episodes_per_iteration) * config.episodes_per_iteration
    return Episodes(**{name: tensors[f"buffer.{name}"][:n].numpy() for name in FIELDS})


def restore_training(learner: Learner, tensors: dict[str, Tensor], header: dict[str, Any]) -> int:
    """Put ``learner`` into the stored state; return the number of iterations done."""
    for name, network in learner.networks().items():
        network.load_state_dict({key: tensors[f"{name}.{key}"] for key in network.state_dict()})
    for name, optimizer in learner.optimizers().items():
        for key, value in optimizer.state.items():
            saved = tensors.get(f"{name}.0.{key}", value)  # older files lack what had not made a step yet
            if saved.shape != value.shape:
                raise UserError(f"{name} of the training state has another size; --restart begins anew")
            value.copy_(saved)
    with torch.no_grad():
        for name, value in learner.agent.tensors().items():
            value.copy_(tensors[f"agent.{name}"])
    stored = Episodes(**{name: tensors[f"buffer.{name}"].numpy() for name in FIELDS})
    n_missing = len(stored) - len(learner.buffer)
    learner.buffer.extend(Episodes(**{name: getattr(stored, name)[-n_missing:] for name in FIELDS}))
    for name, table in _tables(learner).items():
        table.projection = tensors[f"{name}.projection"].numpy()
        table.keys, table.counts = tensors[f"{name}.keys"].numpy(), tensors[f"{name}.counts"].numpy()
    learner.counts.scaling, learner.scaled_at = learner.regression.distance.scaling.numbers(), header["scaled_at"]
    learner.generator.set_state(tensors["torch_generator"])
    learner.rng.bit_generator.state = header["rng"]
    return int(header["iteration"])


def _tables(learner: Learner) -> dict[str, Any]:
    return {"visits": learner.counts.visit_table, "reached": learner.counts.reached_table}


def _arrays(learner: Learner) -> dict[str, np.ndarray]:
    episodes = learner.buffer.episodes()
    arrays = {f"buffer.{name}": getattr(episodes, name) for name in FIELDS}
    for name, table in _tables(learner).items():
        arrays |= {f"{name}.{key}": getattr(table, key) for key in ("projection", "keys", "counts")}
    return arrays
