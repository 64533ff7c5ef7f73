"""How far is it, says who? Steps to two goals over a maze: ``python -m benchmarks.distance_maps --env point_maze``.

True shortest paths, the straight line, and d of the models that ship, at rest, by the policy's action. Goals are one
of the task and one in the room that its episodes never need. Nothing is trained.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.cells import RESULTS
from benchmarks.command import read_options
from benchmarks.value_maps import a_maze
from mpc.cost import EuclideanSteps, GivenSteps, LearnedSteps, StepsToGo
from napsp import envs as tasks
from napsp.errors import run_command
from napsp.storage.checkpoint import load_model
from napsp.storage.record import save_figure
from napsp.storage.shipped import SHIPPED
from planners.app.maze_map import BINS, at_rest, draw_field, in_walls, steps_field

GOALS = {"a goal of the task": (0.5, 0.5), "a goal in the room that episodes never need": (0.5, -0.5)}
"""In half widths of the house."""
TRUTH = "shortest path around the walls"


@dataclass(frozen=True)
class MapOptions:
    """Draw distances over a maze beside the true ones."""

    env: str = "point_maze"
    """point_maze or point_maze_long."""
    bins: int = BINS
    """Points per side."""


def estimates(env_name: str) -> dict[str, StepsToGo]:
    """Whom to ask, by name: the truth first, then those that know less."""
    world: Any = tasks.make(env_name).unwrapped
    found: dict[str, StepsToGo] = {
        TRUTH: GivenSteps(world.shortest_steps), "straight line": EuclideanSteps(world.step_length)
    }  # fmt: skip
    for name in (env_name, f"{env_name}_plus"):
        if (SHIPPED / name).is_dir():
            model = load_model(SHIPPED / name, env_name)
            found[f"d of {name} ({model.config.method})"] = LearnedSteps(model)
    return found


def fields(env_name: str, goal: tuple[float, float], bins: int) -> dict[str, np.ndarray]:
    """Steps ``(bins, bins)`` [y, x] to a goal, in half widths of the house; NaN inside walls."""
    world: Any = tasks.make(env_name).unwrapped
    there = world.scale * np.array(goal)
    found = {name: steps_field(steps, world.scale, there, bins) for name, steps in estimates(env_name).items()}
    blocked = in_walls(at_rest(world.scale, bins)[:, :2], world.scale).reshape(bins, bins)
    return {name: np.where(blocked, np.nan, field) for name, field in found.items()}


def main() -> int:
    """Draw."""
    options = read_options(MapOptions, "distance_maps")
    env_name = a_maze(options.env)
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    scale = tasks.make(env_name).unwrapped.scale
    rows = {name: fields(env_name, goal, options.bins) for name, goal in GOALS.items()}
    n = len(next(iter(rows.values())))
    figure, axes = plt.subplots(len(rows), n, figsize=(3.1 * n, 3.2 * len(rows)), layout="constrained")
    for line, (name, found) in zip(axes, rows.items(), strict=True):
        most = float(np.nanmax(found[TRUTH]))
        image: Any = None
        for axis, (who, field) in zip(line, found.items(), strict=True):
            image = draw_field(axis, field, scale)
            image.set_clim(0.0, most)
            axis.plot(*(scale * np.array(GOALS[name])), "r*")
            off = f"\noff by {np.nanmean(np.abs(field - found[TRUTH])):.1f} steps in the mean" if who != TRUTH else ""
            axis.set_title(who + off, fontsize=9)
        line[0].set_ylabel(name, fontsize=9)
        figure.colorbar(image, ax=line, shrink=0.8, label="steps", extend="max")
    path = RESULTS / f"distance_maps_{env_name}.png"
    save_figure(figure, path)
    print(f"picture: {path}")
    return 0


if __name__ == "__main__":
    run_command(main)
