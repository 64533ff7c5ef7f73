"""Files of before: models whose configuration was one flat list of options, states that held all of D in one file."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from napsp.data.episodes import BLOWN
from napsp.envs import episode_length
from napsp.renamed import TRAINING
from napsp.storage.files import FORMAT, OLDER


def todays(tensors: dict[str, Tensor], header: dict[str, Any]) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """The content of a model file as it would be written today."""
    header = _with_stay(header)
    if header["format"] != OLDER:
        return tensors, header
    renamed = {name.replace("distance.net.", "distance.heads.0.net."): value for name, value in tensors.items()}
    return renamed, {**header, "config": todays_config(header["config"])}


def todays_state(tensors: dict[str, Tensor], header: dict[str, Any]) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """The content of a training state with the header of today; ``buffer.`` tensors still have D where they had it.

    What its header calls ``inherited`` are options that the run began without, with what they were then.
    """
    written, header = header["config"], _with_stay(header)
    inherited = {} if header["config"] is written else {"bootstrap.stay": header["config"]["bootstrap"]["stay"]}
    header = {"inherited": inherited, **header}
    if header["format"] != FORMAT:
        return tensors, header
    names = ("observations", "actions", "desired_goals")
    endings, lengths = tensors["buffer.endings"], tensors["buffer.lengths"]
    totals = {"steps": int(lengths.sum()), "blown": int((endings == BLOWN).sum())}
    return tensors, {
        "sizes": [tensors[f"buffer.{name}"].shape[-1] for name in names],
        "replay": {"start": 0, "end": len(lengths), **totals},
        "episodes": [],
        "counts": [],
        **header,
    }


def _with_stay(header: dict[str, Any]) -> dict[str, Any]:
    """The header of a run of plus of before arrivals had to last says so."""
    config = header["config"]
    if config.get("method") != "plus" or "stay" in config.get("bootstrap", {}):
        return header
    return {**header, "config": {**config, "bootstrap": {**config["bootstrap"], "stay": 0.0}}}


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
