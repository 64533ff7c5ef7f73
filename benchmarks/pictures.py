"""The pictures of README: ``python -m benchmarks.pictures``.

Each is planned and drawn anew with the models that ship, on the first seed, 0, which was not picked. It takes some
minutes.
"""

from __future__ import annotations

import sys

from planners.app.gl import choose_gl

if __name__ == "__main__":
    choose_gl()  # before anything imports mujoco

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.command import read_options
from benchmarks.filmed import Shot, View, beside, filmed, write_gif
from napsp.errors import run_command
from napsp.storage.record import save_figure
from planners.app.maze_map import draw_field, steps_field

FOLDER = Path("docs") / "images"
ALONE = {"proposals": False}  # no policy helps: the two differ in their cost and in nothing else
ALONG_THE_WALL = View(168.0, -14.0, 1.15, (1.3, 0.76, 0.5))
Name = Literal["fetch_wall", "fetch_pick_place_wall", "point_maze"]


@dataclass(frozen=True)
class PictureOptions:
    """Draw the pictures of README from scratch, into docs/images."""

    only: tuple[Name, ...] = ("fetch_wall", "fetch_pick_place_wall", "point_maze")
    """Which."""
    seed: int = 0
    """Episode seed."""
    out: Path = FOLDER
    """Folder."""


def fetch_wall(path: Path, seed: int) -> None:
    """The same episode, search and budget with two costs: the straight line beside d."""
    line = Shot("MPPI, cost: straight line", "mppi", {"env": "fetch_wall", "cost": "euclidean", **ALONE})
    learned = Shot("MPPI, cost: d", "mppi", {"env": "fetch_wall", "cost": "distance", **ALONE})
    left, right = (filmed(shot, seed, 18, ALONG_THE_WALL, 380) for shot in (line, learned))
    write_gif(path, beside(left, right))


def fetch_pick_place_wall(path: Path, seed: int) -> None:
    """Grasp a box, lift it over the wall, with the policy's rollout among the samples."""
    shot = Shot("iCEM, cost: d, policy's rollout among the samples", "icem", {"env": "fetch_pick_place_wall"})
    write_gif(path, filmed(shot, seed, 22, None, 380))


def point_maze(path: Path, seed: int) -> None:
    """Steps to one goal over the maze as two costs see them, and where MPPI goes with each."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    line = Shot("straight line", "mppi", {"env": "point_maze", "cost": "euclidean", **ALONE})
    learned = Shot("learned distance d", "mppi", {"env": "point_maze", **ALONE}, Path("point_maze_plus"))
    figure, axes = plt.subplots(1, 2, figsize=(7.2, 3.7), layout="constrained")
    panels = [_planned(shot, seed) for shot in (line, learned)]
    most = max(field.max() for field, *_ in panels)
    for axis, shot, (field, scale, result) in zip(axes, (line, learned), panels, strict=True):
        image = draw_field(axis, field, scale)
        image.set_clim(0, most)
        axis.plot(*result.achieved_goals[: result.first_hit and result.first_hit + 1].T, color="red", linewidth=2)
        axis.plot(*result.achieved_goals[0], "o", color="red", markeredgecolor="white", markersize=8)
        axis.plot(*result.desired_goal, "*", color="red", markeredgecolor="white", markersize=14)
        outcome = f"at the goal in step {result.first_hit}" if result.first_hit else f"stuck, {len(result.steps)} steps"
        axis.set_title(f"{shot.title}: {outcome}", fontsize=10)
    figure.colorbar(image, ax=axes, label="steps to go, at rest", shrink=0.85)
    save_figure(figure, path)


def _planned(shot: Shot, seed: int) -> tuple[np.ndarray, float, Any]:
    """The cost's field ``(bins, bins)`` of the episode's goal, the maze's scale, and the episode."""
    session = shot.open()
    try:
        result, scale = session.run_episode(seed), session.env.unwrapped.scale
        return steps_field(session.controller.cost.to_go, scale, result.desired_goal), scale, result
    finally:
        session.close()


PICTURES: dict[str, tuple[str, Callable[[Path, int], None]]] = {
    "fetch_wall": ("fetch_wall.gif", fetch_wall),
    "fetch_pick_place_wall": ("fetch_pick_place_wall.gif", fetch_pick_place_wall),
    "point_maze": ("point_maze.png", point_maze),
}


def main() -> int:
    """Draw."""
    options = read_options(PictureOptions, "pictures")
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.only:
        file, draw = PICTURES[name]
        draw(options.out / file, options.seed)
        print(f"picture: {options.out / file}", flush=True)
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
