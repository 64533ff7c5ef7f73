"""Model files of format napsp-1, whose configuration was one flat list of options."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from napsp.envs import episode_length
from napsp.renamed import TRAINING
from napsp.storage.files import OLDER


def todays(tensors: dict[str, Tensor], header: dict[str, Any]) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """The content of a model file as it would be written today."""
    config = header["config"]
    if config.get("method") == "plus" and "stay" not in config.get("bootstrap", {}):
        # No arrival had to last yet.
        header = {**header, "config": {**config, "bootstrap": {**config["bootstrap"], "stay": 0.0}}}
    if header["format"] != OLDER:
        return tensors, header
    renamed = {name.replace("distance.net.", "distance.heads.0.net."): value for name, value in tensors.items()}
    return renamed, {**header, "config": todays_config(header["config"])}


def todays_config(old: dict[str, Any]) -> dict[str, Any]:
    """A flat configuration under today's names, some values in today's units."""
    values = {"epsilon": 0.1, "exploration_hold": 6, "discount": 0.98, "min_entropy_weight": 0.02, **old}
    for gone in ("compiled", "reached_bits"):
        values.pop(gone, None)
    # Epsilon was the chance that a held action starts; it is the share of random steps.
    length = 0.5 * (1 + values["exploration_hold"])
    chance = values["epsilon"]
    values["epsilon"] = round(chance * length / (chance * length + 1.0 - chance), 12)
    if old.get("method") != "sparse" and old.get("agent") != "ddpg":
        # Alpha's floor was in units of reward; it is in lost steps.
        values["min_entropy_weight"] *= round(episode_length(old["env"]) * (1.0 - values["discount"]), 12)
    nested: dict[str, Any] = {}
    for name, value in values.items():
        head, _, rest = TRAINING.get(name, name).rpartition(".")
        (nested.setdefault(head, {}) if head else nested)[rest] = value
    return nested
