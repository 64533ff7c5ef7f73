"""Does the time of a plan grow linearly with its samples? ``python -m benchmarks.throughput --scaling``.

Plans with more and more samples at the same states, straight lines fitted to the median times, and the peak memory of
the process. Noise is of one size in every task. Rows go to ``results/throughput_scaling.csv``, the figure to
``results/throughput_scaling_ENV.png``.
"""

from __future__ import annotations

import gc
import resource
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cells import RESULTS, replace_results
from benchmarks.machine import machine
from benchmarks.rollout_speed import clocked
from napsp import envs as tasks
from napsp.envs.dynamics import get_state
from napsp.settings import changed
from napsp.storage.record import save_figure
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session

SAMPLES = tuple(2**k for k in range(4, 11))
COLUMNS = ("env", "cost", "horizon", "samples")
"""What identifies a row."""
State = tuple[np.ndarray, dict[str, np.ndarray]]
"""Full simulator state ``(S,)`` and the observation that belongs to it."""


def episode_states(env: str, horizon: int, rounds: int) -> list[State]:
    """States along one episode that is planned with the straight-line cost."""
    config = PlanConfig.of("mppi", {"env": env, "horizon": horizon, "cost": "euclidean", "search.finest": 1.0})
    session = Session.open(config, RunOptions(threads=1))
    world, states = session.env.unwrapped, []
    observation, _ = session.env.reset(seed=0)
    for _ in range(rounds):
        states.append((get_state(world.model, world.data), observation))
        observation, *_ = session.env.step(session.controller.plan(world, observation).action)
    session.close()
    return states


def peak_mb() -> float:
    """The most memory this process has ever held, MB; helper processes, which share most of it, not included."""
    # Linux counts in KiB, macOS in bytes.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024.0**2 if sys.platform == "darwin" else 1024.0)


def measure(
    config: PlanConfig[Any], options: RunOptions, sizes: list[tuple[int, int]], rounds: int
) -> list[dict[str, Any]]:
    """One row per size (samples, horizon), the smallest first: a peak of memory is then due to the last one.

    Every size opens its own environment, whose memory the allocator reuses from about the fourth one on: what the
    samples themselves need shows in the larger sizes.
    """
    states, rows = episode_states(config.env, config.usual.horizon, rounds), []
    for samples, horizon in sorted(sizes, key=lambda size: size[0] * size[1]):
        gc.collect()  # the last size's environment, whose parts refer to each other
        before = peak_mb()
        session = Session.open(changed(config, {"search.samples": samples, "horizon": horizon}), options)
        controller = session.controller
        controller.plan_from(*states[0])  # first call: allocation
        times = [clocked(partial(controller.plan_from, *state), controller.engine) for state in states]
        wall, cpu = (round(float(ms), 4) for ms in 1e3 * np.median(times, axis=0))
        session.close()
        row = dict(zip(COLUMNS, (config.env, config.cost, horizon, samples), strict=True))
        row |= {"threads": controller.engine.n_threads, "cpu_ms": cpu, "wall_ms": wall}
        rows.append(row | {"peak_mb_before": round(before, 1), "peak_mb_after": round(peak_mb(), 1)} | machine())
        print(f"{config.env:12s} {samples:5d} x {horizon:2d} {wall:9.2f} ms wall {cpu:9.2f} ms CPU {peak_mb():7.1f} MB")
    return rows


def fit_line(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """Intercept, slope and R^2 of the least-squares line through points ``(n,)``."""
    slope, intercept = np.polyfit(x, y, 1)
    residual = y - (intercept + slope * x)
    return float(intercept), float(slope), 1.0 - float((residual**2).sum() / ((y - y.mean()) ** 2).sum())


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Times against samples with their fitted lines, one colour per horizon."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axis = plt.subplots(figsize=(6, 3.6), layout="constrained")
    for i, horizon in enumerate(sorted({row["horizon"] for row in rows})):
        samples = np.array([row["samples"] for row in rows if row["horizon"] == horizon], float)
        for clock, marker, style in (("wall", "o", "-"), ("cpu", "x", "--")):
            ms = np.array([row[f"{clock}_ms"] for row in rows if row["horizon"] == horizon])
            intercept, slope, r2 = fit_line(samples, ms)
            label = f"{horizon} steps, {clock}: {intercept:.1f} + {slope:.3f} N ms, R² = {r2:.4f}"
            print(label)
            axis.plot(samples, ms, marker, color=f"C{i}")
            axis.plot(samples, intercept + slope * samples, style, color=f"C{i}", linewidth=1, label=label)
    axis.set(xlabel="samples per plan N", ylabel="median time per plan [ms]", ylim=(0, None))
    axis.set_title(f"{rows[0]['env']}: MPPI, cost {rows[0]['cost']}, {rows[0]['threads']} threads", fontsize=10)
    axis.legend(fontsize=8)
    save_figure(figure, path)


def run(
    config: PlanConfig[Any], options: RunOptions, samples: tuple[int, ...], horizons: tuple[int, ...], rounds: int
) -> None:
    """Measure every size, fit, write rows and figure."""
    rows = measure(config, options, [(n, h) for n in samples for h in horizons], rounds)
    replace_results(RESULTS / "throughput_scaling.csv", COLUMNS, rows)
    draw(rows, RESULTS / f"throughput_scaling_{tasks.file_name(config.env)}.png")
