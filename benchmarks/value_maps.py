"""Figure 4: the value and the learned distance over the maze. ``python -m benchmarks.value_maps``.

For each method, from a run that is trained first if it does not exist: the critic's value
Q(s, pi(s, g), g) and d(s, pi(s, g), g) at states at rest, for one goal.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

from benchmarks.cells import RESULTS, trained
from napsp import envs as tasks
from napsp.checkpoint import load_model, read_tensors
from napsp.config import METHODS, preset
from napsp.envs.point_maze import INNER_WALLS, OUTER_WALLS
from napsp.errors import UserError, run_command
from napsp.networks import Critic
from napsp.record import save_figure
from napsp.resume import STATE_FILE


@dataclass(frozen=True)
class MapOptions:
    """Draw value and distance over the maze."""

    env: str = "point_maze"
    """point_maze or point_maze_long."""
    seed: int = 0
    """Training seed."""
    bins: int = 60
    """Points per side."""


def load_critic(folder: Path, sizes: tuple[int, int, int], hidden: tuple[int, ...]) -> Critic:
    """The critic of a finished run, from its training state."""
    tensors, _ = read_tensors(folder / STATE_FILE, "training state")
    weights = {k.removeprefix("critic."): v for k, v in tensors.items() if k.startswith("critic.")}
    n_critics = len({name.split(".")[1] for name in weights if name.startswith("nets.")})
    critic = Critic(sizes, hidden, n_critics)
    critic.load_state_dict(weights)
    return critic


def maps(folder: Path, env_name: str, scale: float, bins: int) -> dict[str, np.ndarray]:
    """Value and distance ``(bins, bins)`` [y, x]; the distance is missing for ``sparse``."""
    model = load_model(folder, env_name)
    centres = (np.arange(bins) + 0.5) / bins * 2 * scale - scale
    x, y = np.meshgrid(centres, centres)
    rows = np.stack([x.ravel(), y.ravel(), np.zeros(x.size), np.zeros(x.size)], axis=1)
    states = torch.from_numpy(rows.astype(np.float32))
    goals = torch.tensor([0.5, 0.5]).mul(scale).expand(len(states), -1)
    critic = load_critic(folder, tuple(model.header["sizes"]), model.config.hidden)
    with torch.inference_mode():
        actions = model.policy.mode(states, goals)
        found = {"value": critic(states, actions, goals).amin(0)}
        if model.distance is not None:
            found["d [steps]"] = model.distance.steps(states, actions, goals)
    return {name: values.numpy().reshape(bins, bins) for name, values in found.items()}


def draw_walls(axis: Any, scale: float) -> None:
    """The walls of the house as black boxes."""
    from matplotlib.patches import Rectangle

    for x, y, half_x, half_y in INNER_WALLS + OUTER_WALLS:
        corner = (x - half_x - 0.015) * scale, (y - half_y - 0.015) * scale
        axis.add_patch(Rectangle(corner, 2 * (half_x + 0.015) * scale, 2 * (half_y + 0.015) * scale, color="black"))
    axis.set(
        xticks=[], yticks=[], aspect="equal", xlim=(-1.05 * scale, 1.05 * scale), ylim=(-1.05 * scale, 1.05 * scale)
    )


def main() -> int:
    """Train what is missing and draw."""
    options = tyro.cli(MapOptions, prog="python -m benchmarks.value_maps")
    env_name = tasks.canonical_name(options.env)
    if not env_name.startswith("point_maze"):
        raise UserError(f"maps are drawn for point_maze and point_maze_long only, not for {env_name}")
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    scale = tasks.make(env_name).unwrapped.scale
    figure, axes = plt.subplots(2, len(METHODS), figsize=(3 * len(METHODS), 6), layout="constrained")
    for column, method in enumerate(METHODS):
        folder = trained(preset(env_name, method=method, seed=options.seed))
        found = maps(folder, env_name, scale, options.bins)
        for axis, name in zip(axes[:, column], ("value", "d [steps]"), strict=True):
            axis.set_title(f"{method}: {name}", fontsize=9)
            if name not in found:
                axis.axis("off")
                continue
            colours = "viridis" if name == "value" else "viridis_r"
            image = axis.imshow(found[name], origin="lower", extent=[-scale, scale] * 2, cmap=colours)
            figure.colorbar(image, ax=axis, shrink=0.7)
            axis.plot(0.5 * scale, 0.5 * scale, "r*")
            draw_walls(axis, scale)
    path = RESULTS / f"figure4_{env_name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, path)
    print(f"picture: {path}")
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
