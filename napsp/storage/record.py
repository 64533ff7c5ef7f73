"""What a training run leaves beside its weights: how it was made, and its curve."""

from __future__ import annotations

import io
import platform
from pathlib import Path
from typing import Any

import mujoco
import torch

from napsp.config import PAPER, TrainConfig, preset, to_dict
from napsp.settings import as_flags, differences
from napsp.storage.files import write_atomically, write_json
from napsp.storage.progress import Row

RECORD_FILE = "training.json"
CURVE_FILE = "training_curve.png"


def command_line(config: TrainConfig) -> str:
    """The command that repeats a run: task, method, recipe and seed, and what differs from their defaults."""
    default = preset(config.env, config.method, config.recipe, seed=config.seed)
    words = f"python -m napsp.train --env {config.env} --method {config.method} --seed {config.seed}"
    words += f" --recipe {config.recipe}" if config.recipe != PAPER else ""
    return f"{words} {as_flags(differences(config, default))}".rstrip()


def write_record(folder: Path, config: TrainConfig, rows: list[Row], revisions: list[str]) -> None:
    """Write :data:`CURVE_FILE`, then :data:`RECORD_FILE`; ``revisions`` are those the run was trained by."""
    draw_curve(folder / CURVE_FILE, config, rows)
    record = {
        "command": command_line(config),
        "revision": ", ".join(revisions),
        "seed": config.seed,
        "config": to_dict(config),
        "episodes": rows[-1]["episodes"],
        "minutes": round(rows[-1]["seconds"] / 60, 2),
        "final": rows[-1],
        "versions": {"python": platform.python_version(), "torch": torch.__version__, "mujoco": mujoco.__version__},
    }
    write_json(folder / RECORD_FILE, record)


def save_figure(figure: Any, path: Path) -> None:
    """Write a matplotlib figure as PNG, atomically, in a folder that may have to be made, and close it."""
    from matplotlib import pyplot as plt

    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=110)
    plt.close(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, image.getvalue())


def draw_curve(path: Path, config: TrainConfig, rows: list[Row]) -> None:
    """Success, distances and the rates of the triangular loss over training episodes."""
    from matplotlib.figure import Figure  # not pyplot, which is for the main thread, and may be showing the user's own

    panels = {
        "success rate": ("success_rate", "any_success_rate"),
        "distance [steps]": ("mean_distance", "distance_at_goal"),
        "rates of eq. 4b": ("merging_rate", "relaxation_rate"),
    }
    panels = {title: names for title, names in panels.items() if any(name in row for row in rows for name in names)}
    width = 10 * len(panels) / 3  # inches; margins are given, for layouts that find them draw all twice
    margins = {"left": 0.5 / width, "right": 1 - 0.1 / width, "bottom": 0.18, "top": 0.81, "wspace": 0.2}
    figure = Figure(figsize=(width, 2.8))
    axes = figure.subplots(1, len(panels), squeeze=False, gridspec_kw=margins)[0]
    for axis, (title, names) in zip(axes, panels.items(), strict=True):
        for name in names:
            points = [(row["episodes"], row[name]) for row in rows if name in row]
            if points:
                axis.plot(*zip(*points, strict=True), ".-" if len(points) < 3 else "-", label=name.replace("_", " "))
        axis.set(xlabel="training episodes", title=title)
        axis.set_ylim(bottom=0)
        if axis.lines:
            axis.legend(fontsize=7)
    figure.suptitle(f"{config.env}, {config.method}, seed {config.seed}", fontsize=10)
    save_figure(figure, path)
