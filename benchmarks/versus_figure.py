"""Figures of policy against planner: success over budgets and over training episodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cells import RESULTS
from napsp import envs as tasks
from napsp.storage.record import save_figure

PLANNERS = ("mppi", "cem", "icem", "predictive_sampling")
SMOOTHING = " + smoothing"


def draw(found: Sequence[Mapping[str, Any]], folder: Path = RESULTS) -> Path | None:
    """Success against samples per step and against training episodes, as far as a task has rows of several.

    ``found`` are rows of one task as benchmarks.policy_vs_mpc.comparable returns them.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    rows = [row for row in found if row["line"].in_figures]
    kinds = list(dict.fromkeys(row["line"] for row in rows))
    several = len(kinds) > 1
    last = {kind: max(int(row["training_episodes"]) for row in rows if row["line"] == kind) for kind in kinds}
    panels: dict[str, dict[str, list[tuple[int, float]]]] = {}
    looks: dict[str, dict[str, Any]] = {}
    for x in ("budget", "training_episodes"):
        lines: dict[str, list[tuple[int, float]]] = {}
        for row in rows:
            name = row["planner"] + (" + policy's rollout" if row["proposals"] == "1" else "")
            name += f" ({row['line'].name})" if several else ""
            looks[name] = _look(row["planner"], row["proposals"] == "1", kinds.index(row["line"]))
            ended = int(row["training_episodes"]) == last[row["line"]]
            if ended if x == "budget" else row["budget"] in ("0", "64"):
                lines.setdefault(name, []).append((int(row[x]), float(row["success_rate"])))
        if any(len(points) > 1 for points in lines.values()):
            panels[x] = lines
    if not rows:
        return None
    env_name = rows[0]["env"]
    path = folder / f"policy_vs_mpc_{tasks.file_name(env_name)}.png"
    if not panels:  # one budget and one checkpoint each: the table says it all
        path.unlink(missing_ok=True)  # of other rows
        return None
    size = (5.2 if len(panels) == 1 else 8, 3 + (0.2 if several else 0.1) * len(looks))
    figure, axes = plt.subplots(1, len(panels), figsize=size, layout="constrained")
    for axis, (x, lines) in zip(np.atleast_1d(axes), panels.items(), strict=True):
        for name, points in lines.items():
            if name.startswith("policy") and x == "budget":
                axis.axhline(points[0][1], label=name, **looks[name] | {"linestyle": ":"})
            elif x == "budget" or len(points) > 1:  # single points stand in the other panel
                axis.plot(*zip(*sorted(points), strict=True), label=name, **looks[name])
        axis.set(
            xlabel={"budget": "plans per control step"}.get(x, "training episodes"), ylabel="success", ylim=(0, 1.05)
        )
    handles = [axis.get_legend_handles_labels() for axis in figure.axes]
    labelled = {name: line for lines, names in handles for line, name in zip(lines, names, strict=True)}
    figure.legend(labelled.values(), labelled.keys(), fontsize=7, ncols=1 if several else 2, loc="outside lower center")
    figure.suptitle(env_name if several else f"{env_name}, {rows[0]['line'].name}", fontsize=10)
    save_figure(figure, path)
    return path


def _look(planner: str, proposals: bool, kind: int) -> dict[str, Any]:
    """A colour for each planner, in every figure; hollow without the policy's rollout; markers tell methods apart."""
    colour = f"C{PLANNERS.index(planner.removesuffix(SMOOTHING))}" if planner != "policy" else "black"
    own, marker = proposals or planner == "policy", "s" if planner.endswith(SMOOTHING) else "o^vD"[kind % 4]
    return {"color": colour, "linestyle": "-" if own else "--", "marker": marker, "markersize": 4,
            "markerfacecolor": colour if own else "white"}  # fmt: skip
