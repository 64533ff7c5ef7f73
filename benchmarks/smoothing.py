"""What does smoothing cost and bring? ``python -m benchmarks.smoothing --env fetch_wall``.

A planner with and without the CasADi layer, with a first-order low-pass, and with coloured noise, on the same episodes.
Cells that are already in ``results/smoothing.csv`` are not run again. One figure shows an episode's actions, the other
smoothness against the time to the goal of all cells there are.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.cells import (
    RESULTS,
    add_result,
    as_text,
    figures_folder,
    find,
    read_results,
    shipped_training,
    training_beside,
    training_of,
)
from benchmarks.command import read_options
from benchmarks.planned import COLUMN, column
from napsp import envs as tasks
from napsp.errors import UserError, run_command
from napsp.statistics import describe, paired_difference, wilson_interval
from napsp.storage.record import save_figure
from napsp.storage.revision import git_revision
from planners.app.config import PlanConfig
from planners.app.episode import EpisodeResult
from planners.app.options import RunOptions
from planners.app.session import Session

PLAIN, SMOOTHED = "plain", "smoothed"
VARIANTS: dict[str, dict[str, Any]] = {
    PLAIN: {},
    SMOOTHED: {"smooth": True},
    "low-pass 0.3": {"low_pass": 0.3},
    "low-pass 0.6": {"low_pass": 0.6},
    "low-pass 0.8": {"low_pass": 0.8},
    "smoothed, rate 4": {"smooth": True, "smooth.rate": 4.0, "smooth.jerk": 1.2},
    "smoothed, tolerance 1": {"smooth": True, "smooth.tolerance": 1.0, "smooth.rate": 4.0, "smooth.jerk": 1.2},
}
USUAL = (PLAIN, SMOOTHED, "low-pass 0.3", "low-pass 0.6", "coloured noise")
COLOURED: dict[str, dict[str, Any]] = {
    "mppi": {"search.noise_correlation": 0.95},
    "predictive_sampling": {"search.noise_correlation": 0.95},
    "icem": {"search.noise_exponent": 4.0},
}
"""Noise of slower changes than the planner's own."""
FIGURES = ("action_rate", "jerk", "search_ms", "smoothing_ms", "accepted_share", "kept_share", "linearise_ms",
           "solve_ms", "verify_ms", "build_ms")  # fmt: skip


@dataclass(frozen=True)
class SmoothingOptions:
    """Compare a planner with and without smoothing on one task."""

    env: str = "fetch_wall"
    """Task."""
    checkpoint: Path | None = None
    """A file or folder written by napsp.train; default: the one that ships for the task."""
    planner: str = "mppi"
    """Planner: mppi, cem, icem or predictive_sampling, with its default options."""
    proposals: bool = True
    """Let the policy's rollout join the samples."""
    episodes: int = 50
    """Episodes per cell."""
    seed: int = 90_000
    """First episode seed; these seeds were never used for tuning."""
    variants: tuple[str, ...] = USUAL
    """Which cells; plain comes first, the others are compared with it."""
    threads: int = 1
    """Simulation threads."""


def plan_config(env: str, planner: str, proposals: bool, settings: dict[str, Any]) -> PlanConfig[Any]:
    """A planner in one variant."""
    return PlanConfig.of(planner, {"env": env, "proposals": proposals, **settings})


def open_session(options: SmoothingOptions, settings: dict[str, Any]) -> Session:
    """A planning session of one variant."""
    config = plan_config(options.env, options.planner, options.proposals, settings)
    return Session.open(config, RunOptions(seed=options.seed, checkpoint=options.checkpoint, threads=options.threads))


def run_cell(session: Session, options: SmoothingOptions) -> dict[str, Any]:
    """Run one cell of the table."""
    results = [session.run_episode(options.seed + i) for i in range(options.episodes)]
    all_ms, smoothing_ms = (np.concatenate([getattr(r, name) for r in results]) for name in ("plan_ms", "smoothing_ms"))
    figures = {
        "success_rate": float(np.mean([r.success for r in results])),
        "any_success_rate": float(np.mean([r.first_hit is not None for r in results])),
        "first_hits": " ".join(str(r.first_hit or "-") for r in results),
        "action_rate": float(np.mean([r.action_rate for r in results])),
        "jerk": float(np.mean([r.jerk for r in results])),
        "search_ms": float(np.median(all_ms - smoothing_ms)),
        "smoothing_ms": float(np.median(smoothing_ms)),
    }
    return figures | (session.smoothing_summary() or {})


def variants_of(planner: str) -> dict[str, dict[str, Any]]:
    """Names of a planner's cells and the options that make them."""
    return VARIANTS | ({"coloured noise": COLOURED[planner]} if planner in COLOURED else {})


def comparable(rows: Sequence[Any], episodes: int = 50, seed: int = 90_000) -> list[Any]:
    """Rows of the same episodes, on one thread, with today's shipped model, by what their variant means."""
    kept = []
    for row in rows:
        settings = variants_of(row["planner"]).get(row["variant"])
        if settings is None or (row["episodes"], row["seed"], row["threads"]) != (str(episodes), str(seed), "1"):
            continue
        planned = plan_config(row["env"], row["planner"], row["proposals"] == "True", settings)
        same_model = (training_of(row), int(row["training_seed"])) == shipped_training(row["env"])
        if same_model and column(planned) == row[COLUMN]:
            kept.append(row)
    return kept


def first_hits(row: Any, never: int) -> list[float]:
    """Control steps to the goal of each episode; an episode that never gets there counts as its length."""
    return [float(never if hit == "-" else hit) for hit in row["first_hits"].split()]


def draw(path: Path, name: str, results: dict[str, EpisodeResult]) -> None:
    """Actions of one episode, one row per variant."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(len(results), 1, figsize=(7, 4.6), sharex=True, sharey=True, layout="constrained")
    for axis, (variant, result) in zip(np.atleast_1d(axes), results.items(), strict=True):
        steps = np.arange(len(result.actions))
        for k, trace in enumerate(result.actions.T):
            axis.step(steps, trace, where="post", linewidth=1.2, label=f"action {k + 1}")
        if result.first_hit is not None:
            axis.axvline(result.first_hit, color="black", linestyle=":", linewidth=1)
        axis.set(ylabel="action", ylim=(-1.08, 1.08))
        axis.set_title(f"{variant}: mean squared action rate {result.action_rate:.3f}", fontsize=10)
    np.atleast_1d(axes)[0].legend(loc="lower right", fontsize=8, ncols=4)
    np.atleast_1d(axes)[-1].set_xlabel("control step (dotted: first at the goal)")
    figure.suptitle(name)
    save_figure(figure, path)


def draw_frontier(path: Path, rows: Sequence[Any]) -> None:
    """Action rate against steps to the goal, a panel per task, planner and proposals; rows of one model each.

    Down and left is better.

    An episode that never arrives counts as its length.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    panels: dict[tuple[str, ...], list[Any]] = {}
    for row in rows:
        panels.setdefault((row["env"], row["planner"], row["proposals"]), []).append(row)
    panels = {name: cells for name, cells in panels.items() if len(cells) > 1}
    if not panels:
        return
    figure, axes = plt.subplots(1, len(panels), figsize=(3.6 * len(panels), 3.2), layout="constrained")
    for axis, ((env, planner, proposals), cells) in zip(np.atleast_1d(axes), panels.items(), strict=True):
        for row in cells:
            hits, rate = np.mean(first_hits(row, tasks.episode_length(env))), float(row["action_rate"])
            kind = next((k for k in ("smoothed", "low-pass", "coloured") if row["variant"].startswith(k)), PLAIN)
            color = {"smoothed": "tab:blue", "low-pass": "tab:orange", "coloured": "tab:green", PLAIN: "black"}[kind]
            axis.scatter(hits, rate, color=color)
            note = row["variant"].removeprefix("smoothed, ")
            axis.annotate(note, (hits, rate), (3, 3), textcoords="offset points", fontsize=6)
        axis.set(xlabel="mean steps to the goal", yscale="log")
        axis.margins(0.4, 0.1)  # room for what the points are called
        axis.set_title(f"{env}, {planner}{'' if proposals == 'True' else ', no proposals'}", fontsize=8)
    np.atleast_1d(axes)[0].set_ylabel("mean squared action rate")
    save_figure(figure, path)


def describe_row(variant: str, row: Any, plain: Any, env_name: str) -> str:
    """One or two lines of the table."""
    n, rate = int(row["episodes"]), float(row["success_rate"])
    never = tasks.episode_length(env_name)
    hits, plain_hits = first_hits(row, never), first_hits(plain, never)
    difference, (low, high) = paired_difference(hits, plain_hits)
    number = {name: float(value) for name, value in row.items() if name in FIGURES and value}
    text = (
        f"{variant:14s} success {describe(rate, wilson_interval(round(rate * n), n))}  "
        f"first hit {np.mean(hits):5.2f} ({difference:+.2f} [{low:+.2f}, {high:+.2f}])  "
        f"action rate {number['action_rate']:.4f} (x {number['action_rate'] / float(plain['action_rate']):.2f})  "
        f"jerk {number['jerk']:.2f}  {number['search_ms']:.1f} + {number['smoothing_ms']:.1f} ms"
    )
    if row.get("calls"):
        text += (
            f"\n{'':14s} accepted {100 * number['accepted_share']:.1f} % of {row['calls']}, "
            f"handed back smooth {100 * number['kept_share']:.1f} %, cost risen in "
            f"{row['risen']}, solver failures {row['solver_failures']}; "
            f"ms: linearise {number['linearise_ms']:.1f}, solve {number['solve_ms']:.1f}, "
            f"verify {number['verify_ms']:.1f}; built once in {number['build_ms']:.1f}"
        )
    return text


def main() -> int:
    """Run missing cells, print the table, draw the figure."""
    options = read_options(SmoothingOptions, "smoothing", episodes=2)
    if options.planner not in ("mppi", "cem", "icem", "predictive_sampling"):
        raise UserError(f"unknown planner {options.planner!r}; choose mppi, cem, icem or predictive_sampling")
    env_name, path = tasks.canonical_name(options.env), RESULTS / "smoothing.csv"
    torch.set_num_threads(1)
    variants = variants_of(options.planner)
    if options.variants[:1] != (PLAIN,) or not set(options.variants) <= {*VARIANTS, "coloured noise"}:
        raise UserError(f"--variants must begin with {PLAIN} and name some of: {', '.join(variants)}")
    plain: Any = None
    shown: dict[str, EpisodeResult] = {}
    for variant in (name for name in options.variants if name in variants):
        settings = variants[variant]
        session = open_session(options, settings)
        training, training_seed = training_beside(options.checkpoint, env_name)
        key = {
            "env": env_name, "planner": options.planner, "proposals": options.proposals, "variant": variant,
            COLUMN: column(session.config), "episodes": options.episodes, "seed": options.seed,
            "training": as_text(training), "training_seed": training_seed, "threads": options.threads,
        }  # fmt: skip
        if find(read_results(path), key) is None:
            add_result(path, key, {**run_cell(session, options), "revision": git_revision()})
        row = find(read_results(path), key)
        assert row is not None
        plain = plain or row
        print(describe_row(variant, row, plain, env_name), flush=True)
        if variant in (PLAIN, SMOOTHED):
            shown[f"{options.planner}, {variant}"] = session.run_episode(options.seed)
        session.close()
    folder = figures_folder(options)
    draw_frontier(folder / "smoothing_frontier.png", comparable(read_results(path), options.episodes, options.seed))
    suffix, words = ("", "") if options.proposals else ("_no_proposals", ", without policy proposals")
    picture = folder / f"smoothing_{env_name}_{options.planner}{suffix}.png"
    draw(picture, f"{env_name}, seed {options.seed}{words}", shown)
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
