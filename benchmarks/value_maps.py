"""Figure 4: the value and the learned distance over the maze. ``python -m benchmarks.value_maps``.

For each method, from a run that is trained first if it does not exist: the critic's value
Q(s, pi(s, g), g) and d(s, pi(s, g), g) at states at rest, for one goal.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from benchmarks.cells import RESULTS, trained
from benchmarks.command import read_options
from benchmarks.critic_steps import load_critic
from mpc.cost import LearnedSteps
from napsp import envs as tasks
from napsp.config import PAPER_METHODS, preset
from napsp.errors import UserError, run_command
from napsp.storage.checkpoint import load_model
from napsp.storage.record import save_figure
from planners.app.maze_map import BINS, at_rest, draw_field, steps_field


@dataclass(frozen=True)
class MapOptions:
    """Draw value and distance over the maze."""

    env: str = "point_maze"
    """point_maze or point_maze_long."""
    seed: int = 0
    """Training seed."""
    bins: int = BINS
    """Points per side."""


def a_maze(name: str) -> str:
    """The task of this name, if maps can be drawn of it.

    Raises:
        UserError: it is no maze.
    """
    env_name = tasks.canonical_name(name)
    if not env_name.startswith("point_maze"):
        raise UserError(f"maps are drawn for point_maze and point_maze_long only, not for {env_name}")
    return env_name


def maps(folder: Path, env_name: str, scale: float, bins: int) -> dict[str, np.ndarray]:
    """Value and distance ``(bins, bins)`` [y, x]; the distance is missing for ``sparse``."""
    model = load_model(folder, env_name)
    goal = np.array([0.5, 0.5]) * scale
    states = torch.from_numpy(at_rest(scale, bins).astype(np.float32))
    goals = torch.from_numpy(goal.astype(np.float32)).expand(len(states), -1)
    critic = load_critic(folder, model)
    with torch.inference_mode():
        values = critic(states, model.policy.mode(states, goals), goals).amin(0)
    found = {"value": values.numpy().reshape(bins, bins)}
    if model.distance is not None:
        found["d [steps]"] = steps_field(LearnedSteps(model), scale, goal, bins)
    return found


def main() -> int:
    """Train what is missing and draw."""
    options = read_options(MapOptions, "value_maps")
    env_name = a_maze(options.env)
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    scale = tasks.make(env_name).unwrapped.scale
    figure, axes = plt.subplots(2, len(PAPER_METHODS), figsize=(3 * len(PAPER_METHODS), 6), layout="constrained")
    for column, method in enumerate(PAPER_METHODS):
        folder = trained(preset(env_name, method=method, seed=options.seed))
        found = maps(folder, env_name, scale, options.bins)
        for axis, name in zip(axes[:, column], ("value", "d [steps]"), strict=True):
            axis.set_title(f"{method}: {name}", fontsize=9)
            if name not in found:
                axis.axis("off")
                continue
            colours = "viridis" if name == "value" else "viridis_r"
            figure.colorbar(draw_field(axis, found[name], scale, colours), ax=axis, shrink=0.7)
            axis.plot(0.5 * scale, 0.5 * scale, "r*")
    path = RESULTS / f"figure4_{env_name}.png"
    save_figure(figure, path)
    print(f"picture: {path}")
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
