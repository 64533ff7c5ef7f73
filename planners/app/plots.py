"""Pictures of planned episodes over their control steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from napsp.envs.gap import world_gap
from napsp.storage.record import save_figure
from planners.app.episode import EpisodeResult
from planners.app.session import Session

SHOWN_EPISODES = 3  # more hide each other
# Fixed margins: layouts that fit themselves to their labels draw everything twice.
SIDE_BY_SIDE = {"left": 0.07, "right": 0.985, "bottom": 0.14, "top": 0.82, "wspace": 0.2}
STACKED = {"left": 0.13, "right": 0.98, "bottom": 0.08, "top": 0.89, "hspace": 0.18}


def plot_distance_to_go(path: Path, session: Session, results: list[EpisodeResult]) -> None:
    """Draw the cost's steps to go and the straight-line gap over the steps of each episode."""
    plt = _pyplot()
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), gridspec_kw=SIDE_BY_SIDE)
    world = session.env.unwrapped
    unit = world_gap(world, np.zeros(1))[1]
    label = f"gap to the goal [{unit}]" if unit else "gap to the goal"
    for result in results:
        color = "tab:blue" if result.success else "tab:red"
        steps = np.arange(1, len(result.steps) + 1)
        left.plot(steps, result.column("steps_to_go"), color=color, alpha=0.5, linewidth=1)
        right.plot(steps, world_gap(world, result.column("gap"))[0], color=color, alpha=0.5, linewidth=1)
    left.set(xlabel="control step", ylabel="steps to go", title=f"cost: {session.config.cost}")
    right.set(
        xlabel="control step",
        ylabel=label,
        title="blue: success, red: failure",
    )
    if world.goal_radius is not None:
        radius = float(world_gap(world, np.array(world.goal_radius))[0])
        right.axhline(radius, color="black", linestyle=":", linewidth=1)
    for axis in (left, right):
        axis.set_ylim(bottom=0)
    figure.suptitle(f"{session.env_name}, {session.config.planner}, {len(results)} episodes")
    save_figure(figure, path)


def plot_steps(path: Path, session: Session, results: list[EpisodeResult]) -> None:
    """Draw how planning went at each control step of the first episodes: cost, samples used, time."""
    plt = _pyplot()
    figure, (costs, shares, times) = plt.subplots(3, 1, figsize=(7, 6.6), sharex=True, gridspec_kw=STACKED)
    for k, result in enumerate(results[:SHOWN_EPISODES]):
        steps, style = np.arange(1, len(result.steps) + 1), {"color": f"C{k}", "linewidth": 1.2}
        costs.plot(steps, result.column("cost"), **style, label=f"seed {result.seed}")
        costs.plot(steps, result.column("steps_to_go"), **style, linestyle=":")
        shares.plot(steps, 100 * result.column("effective_share"), **style)
        times.plot(steps, result.column("plan_ms"), **style)
        for axis in (costs, shares, times) if result.first_hit else ():
            axis.axvline(result.first_hit, color=f"C{k}", linestyle="--", linewidth=0.8, alpha=0.6)
    if session.control_period is not None:
        period = 1e3 * session.control_period
        times.axhline(period, color="black", linestyle=":", linewidth=1, label=f"control period, {period:.3g} ms")
        times.legend(fontsize=8)
    costs.set(ylabel="steps", title="cost of the executed plan (solid), distance to go after its action (dotted)")
    shares.set(ylabel="effective sample\nsize [% of samples]")
    times.set(ylabel="plan call [ms]", xlabel="control step (dashed: first at the goal)")
    costs.legend(fontsize=8)
    for axis in (costs, shares, times):
        axis.set_ylim(bottom=0)
    figure.suptitle(f"{session.env_name}, {session.config.planner}, cost {session.config.cost}")
    save_figure(figure, path)


def _pyplot() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    return plt
