"""Figure 6: where the four methods have been in the long maze. ``python -m benchmarks.coverage``.

Runs that do not exist yet are trained first; the picture is drawn from their replay buffers.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.cells import RESULTS, add_result, as_text, find, read_results, trained
from benchmarks.command import read_options
from napsp import envs as tasks
from napsp.config import PAPER_METHODS, preset
from napsp.errors import UserError, run_command
from napsp.storage.files import read_tensors
from napsp.storage.progress import read_rows
from napsp.storage.record import save_figure
from napsp.storage.resume import stored_episodes
from planners.app.maze_map import draw_walls


@dataclass(frozen=True)
class CoverageOptions:
    """Draw the state coverage of the four methods."""

    env: str = "point_maze_long"
    """point_maze or point_maze_long."""
    seeds: tuple[int, ...] = (0,)
    """Training seeds; the picture shows the first."""
    bins: int = 20
    """Cells per side for the coverage figure."""


def visited(folder: Path) -> np.ndarray:
    """Every position in the replay buffer of a run, in order, ``(E, T + 1, 2)``."""
    return stored_episodes(folder).achieved_goals


def coverage(positions: np.ndarray, scale: float, bins: int) -> tuple[float, float]:
    """Share of cells visited: of the whole house, and of the goal room (upper right)."""
    grid, _, _ = np.histogram2d(*positions.reshape(-1, 2).T, bins=bins, range=[[-scale, scale]] * 2)
    return float((grid > 0).mean()), float((grid[bins // 2 :, bins // 2 :] > 0).mean())


def draw(path: Path, panels: dict[str, np.ndarray], scale: float, captions: dict[str, str]) -> None:
    """One panel per method: positions coloured by when they were visited, walls, start and goal rooms."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(panels), figsize=(3.2 * len(panels), 3.6), layout="constrained")
    for axis, (method, positions) in zip(np.atleast_1d(axes), panels.items(), strict=True):
        points = positions[:, ::2].reshape(-1, 2)
        order = np.repeat(np.arange(len(positions)), positions[:, ::2].shape[1])
        dots = axis.scatter(*points.T, c=order, s=0.4, cmap="viridis", rasterized=True)
        axis.text(-0.5 * scale, -0.5 * scale, "start", ha="center", color="red")
        axis.text(0.5 * scale, 0.5 * scale, "goals", ha="center", color="red")
        axis.set_title(f"{method}\n{captions[method]}")
        draw_walls(axis, scale)
    figure.colorbar(dots, ax=axes, label="training episode", shrink=0.7)
    save_figure(figure, path)


def main() -> int:
    """Train what is missing, measure, draw, append to results/coverage.csv."""
    options = read_options(CoverageOptions, "coverage", bins=2)
    env_name, path = tasks.canonical_name(options.env), RESULTS / "coverage.csv"
    if not env_name.startswith("point_maze"):
        raise UserError(f"coverage is drawn for point_maze and point_maze_long only, not for {env_name}")
    scale = tasks.make(env_name).unwrapped.scale
    panels: dict[str, np.ndarray] = {}
    captions: dict[str, str] = {}
    for seed in options.seeds:
        for method in PAPER_METHODS:
            config = preset(env_name, method=method, seed=seed)
            folder = trained(config)
            positions = visited(folder)
            house, goal_room = coverage(positions, scale, options.bins)
            last = read_rows(folder / "metrics.csv", np.inf)[-1]
            training = as_text(config.identity())
            key = {"env": env_name, "method": method, "seed": seed, "training": training, "bins": options.bins}
            figures = {"coverage": house, "goal_room_coverage": goal_room, "success_rate": last["success_rate"],
                       "any_success_rate": last["any_success_rate"], "episodes": len(positions)}  # fmt: skip
            if find(read_results(path), key) is None:
                add_result(path, key, {"revision": _revision(folder), **figures})
            print("  ".join([f"{method:14s} seed {seed}", *(f"{k} {v:.2f}" for k, v in figures.items())]))
            if seed == options.seeds[0]:
                panels[method], captions[method] = positions, f"house {house:.0%}, goal room {goal_room:.0%}"
    picture = RESULTS / f"coverage_{env_name}.png"
    draw(picture, panels, scale, captions)
    print(f"picture: {picture}")
    return 0


def _revision(folder: Path) -> str:
    return read_tensors(folder / "model.safetensors", "model")[1]["revision"]


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
