"""What it costs to save a run, as its replay grows: ``python -m benchmarks.saving``.

Episodes of random play, made up of numbers, go through a real learner - its counts, its replay - and the real state of
a run: a save writes what is new. Rows of every save go to ``results/saving_NAME.json``, the figure beside it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch

from benchmarks.cells import RESULTS
from benchmarks.command import read_options
from benchmarks.machine import machine
from benchmarks.scaling import peak_mb
from napsp.config import TrainConfig, preset
from napsp.data.episodes import Episodes
from napsp.errors import run_command
from napsp.learner import Learner
from napsp.parts import build_learner
from napsp.storage.files import write_json
from napsp.storage.record import save_figure
from napsp.storage.segments import FOLDER
from napsp.storage.state import STATE_FILE, TrainingState


@dataclass(frozen=True)
class SavingOptions:
    """Save a growing run again and again."""

    episodes: int = 10_000
    """Episodes in the end."""
    steps: int = 700
    """Steps of each."""
    every: int = 100
    """Episodes from save to save."""
    sizes: tuple[int, int, int] = (25, 4, 3)
    """Numbers of an observation, an action and a goal; as in Fetch tasks with a box."""
    method: str = "plus"
    """ours counts N(s, a, g) as well, whose pairs grow with the square of the steps."""
    capacity: int | None = None
    """See --replay-capacity of napsp.train."""
    seed: int = 0
    """Of the made-up numbers."""
    name: str = "10000"
    """Of the files."""


def walks(n: int, options: SavingOptions, rng: np.random.Generator) -> Episodes:
    """Smooth random walks ``(n, T + 1, .)``, whose first numbers are what is achieved."""
    n_observation, n_action, n_goal = options.sizes
    actions = rng.uniform(-1, 1, (n, options.steps, n_action)).astype(np.float32)
    pushes = rng.standard_normal((n, options.steps + 1, n_observation), np.float32)
    observations = np.cumsum(pushes, axis=1, dtype=np.float32) / np.float32(options.steps**0.5)
    achieved = np.ascontiguousarray(observations[:, :, :n_goal])
    return Episodes(observations, achieved, actions, rng.standard_normal((n, n_goal), np.float32))


def learner_of(options: SavingOptions, rng: np.random.Generator) -> Learner:
    """A learner of the default networks, on walks."""
    torch.manual_seed(options.seed)
    config: TrainConfig = preset(
        "fetch_reach", options.method, changes={"graph.every": 0}, replay_capacity=options.capacity
    )
    warmup = walks(config.n_warmup, options, rng)

    def reward(achieved: np.ndarray, goals: np.ndarray) -> np.ndarray:
        return -(np.linalg.norm(achieved - goals, axis=-1) > 0.05).astype(np.float32)

    return build_learner(config, options.sizes, warmup, reward, rng, torch.Generator().manual_seed(options.seed))


def written(folder: Path) -> dict[str, tuple[int, int]]:
    """Size and time of change of all files of a state."""
    files = [folder / STATE_FILE, *(folder / FOLDER).glob("*")]
    return {path.name: (path.stat().st_size, path.stat().st_mtime_ns) for path in files if path.is_file()}


def measure(options: SavingOptions, folder: Path) -> list[dict[str, Any]]:
    """A row for every save: episodes, seconds, bytes that it wrote and that lie there, memory."""
    rng, rows, before = np.random.default_rng(options.seed), [], {}
    learner, state = learner_of(options, rng), TrainingState(folder)
    while learner.buffer.n_seen < options.episodes:
        fresh = walks(options.every, options, rng)
        learner.counts.update(fresh)
        learner.extend_buffer(fresh)
        start = time.perf_counter()
        state.save(learner, len(rows), float(start), [])
        seconds, files = time.perf_counter() - start, written(folder)
        new = sum(size for name, (size, changed) in files.items() if before.get(name) != (size, changed))
        held = sum(array.nbytes for array in vars(learner.buffer.episodes()).values())
        rows.append({
            "episodes": learner.buffer.n_seen, "seconds": round(seconds, 4), "bytes": new,
            "bytes_on_disk": sum(size for size, _ in files.values()), "replay_mb": round(held / 2**20, 1),
            "peak_mb": round(peak_mb(), 1),
        })  # fmt: skip
        before = files
        if len(rows) % 10 == 0:
            print(f"{learner.buffer.n_seen:6d} episodes {seconds:7.3f} s {new / 2**20:8.2f} MB new "
                  f"{rows[-1]['bytes_on_disk'] / 2**20:8.1f} MB in all", flush=True)  # fmt: skip
    return rows


def draw(rows: list[dict[str, Any]], options: SavingOptions, path: Path) -> None:
    """Bytes and seconds of a save, and memory, against episodes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 2.8), layout="constrained")
    panels = {"bytes per save [MB]": ("bytes", 2**20), "seconds per save": ("seconds", 1),
              "peak memory [GB]": ("peak_mb", 1024)}  # fmt: skip
    episodes = [row["episodes"] for row in rows]
    for axis, (title, (name, unit)) in zip(figure.subplots(1, 3), panels.items(), strict=True):
        axis.plot(episodes, [row[name] / unit for row in rows])
        axis.set(title=title, xlabel="episodes", ylim=(0, None))
    figure.axes[2].plot(episodes, [row["replay_mb"] / 1024 for row in rows], "--", label="replay itself")
    figure.axes[2].legend(fontsize=7)
    figure.suptitle(f"{options.method}, {options.steps} steps an episode, a save every {options.every}", fontsize=10)
    save_figure(figure, path)


def main() -> int:
    """Measure, draw, write."""
    options = read_options(SavingOptions, "saving")
    with TemporaryDirectory(dir=Path.cwd()) as folder:
        rows = measure(options, Path(folder))
    path = RESULTS / f"saving_{options.name}.json"
    write_json(path, {"options": vars(options), **machine(), "rows": rows})
    draw(rows, options, path.with_suffix(".png"))
    tenth = max(1, len(rows) // 10)
    first, last = (np.mean([row["bytes"] for row in part]) for part in (rows[1 : 1 + tenth], rows[-tenth:]))
    print(f"a save wrote {first / 2**20:.2f} MB in the beginning and {last / 2**20:.2f} MB in the end; {path}")
    return 0


if __name__ == "__main__":
    run_command(main)
