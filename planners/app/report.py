"""What a planning command leaves behind: live lines, a table, JSON, CSV and plots."""

from __future__ import annotations

import csv
import io
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from napsp.envs.gap import world_gap
from napsp.statistics import describe, wilson_interval
from napsp.storage.files import write_atomically, write_json
from planners.app.episode import COLUMNS, EpisodeResult
from planners.app.folder import clear
from planners.app.plots import plot_distance_to_go, plot_steps
from planners.app.record import describe_session
from planners.app.session import Session


class Report:
    """Collects episodes, speaks while they run, writes the output folder at the end."""

    def __init__(self, folder: Path, session: Session) -> None:
        self._folder, self._session = folder, session
        self.results: list[EpisodeResult] = []
        self._notes: list[str] = []
        self._steps = [",".join(COLUMNS)]  # lines of steps.csv
        # A file or a pipe has no width; a fixed one keeps lines whole.
        self._console = Console(width=None if Console().is_terminal else 110)

    def announce(self, line: str | None = None) -> None:
        """Say what is about to run, then a further line."""
        config, model = self._session.config, self._session.model
        again = f", {config.search.refinements} refinements" if config.search.refinements > 1 else ""
        source = f"d trained for {model.header['episodes']} episodes" if model else "no checkpoint"
        self._console.print(
            f"{config.env}: {config.planner}, cost {config.cost} ({config.where}), "
            f"{config.search.samples} samples x {self._session.horizon} steps{again}, {source}",
            highlight=False,
        )
        if config.model.kind == "coarse":
            own, planned = self._session.substeps
            self._console.print(
                f"planning model: coarse, {planned} physics steps per control step; the environment runs {own}",
                highlight=False,
            )
        if line:
            self._console.print(line, highlight=False, soft_wrap=True)

        if self._session.verified is not None:
            self._console.print(f"tried: {self._session.verified}", highlight=False)

    def note(self, text: str) -> None:
        """Keep a line for the end of the report."""
        self._notes.append(text)

    def add(self, result: EpisodeResult) -> None:
        """Record an episode and print its line; the first one takes the place of an older run's results."""
        if not self.results:
            clear(self._folder)
        self.results.append(result)
        write_atomically(self._folder / "episodes.csv", self._csv().encode())
        self._steps += [",".join(row) for row in result.rows(len(self.results))]
        write_atomically(self._folder / "steps.csv", ("\n".join(self._steps) + "\n").encode())
        n, total = len(self.results), self._session.run.episodes
        hit = f"first hit after {result.first_hit:3d} steps" if result.first_hit else "never at the goal      "
        left = np.mean([r.seconds for r in self.results]) * (total - n)
        gap, unit = world_gap(self._session.env.unwrapped, np.array(result.final_gap))
        shown = f"{_shown(gap.item(), unit):>5s} {unit}".rstrip()
        self._console.print(
            f"  episode {n:3d}/{total}  {'success' if result.success else 'FAILURE'}  {hit}  "
            f"final gap {shown}  {np.median(result.plan_ms):6.1f} ms/plan  {left:4.0f} s left",
            highlight=False,
        )

    def finish(self) -> None:
        """Write summary.json and the plots; print the table."""
        summary = self.summary()
        write_json(self._folder / "summary.json", summary)
        plot_distance_to_go(self._folder / "distance_to_go.png", self._session, self.results)
        plot_steps(self._folder / "steps.png", self._session, self.results)
        self._print(summary)

    def summary(self) -> dict[str, Any]:
        """The content of summary.json."""
        results, n = self.results, len(self.results)
        hits = [r.first_hit for r in results if r.first_hit is not None]
        successes = sum(r.success for r in results)
        plan_ms = np.concatenate([r.plan_ms for r in results])
        period = self._session.control_period
        period_ms = None if period is None else 1e3 * period
        return {
            **describe_session(self._session),
            "episodes": n,
            "success_rate": successes / n,
            "success_interval_95": wilson_interval(successes, n),
            "any_success_rate": len(hits) / n,
            "any_success_interval_95": wilson_interval(len(hits), n),
            "mean_steps_to_goal": float(np.mean(hits)) if hits else None,
            "median_steps_to_goal": float(np.median(hits)) if hits else None,
            "plan_ms_median": float(np.median(plan_ms)),
            "plan_ms_p95": float(np.percentile(plan_ms, 95)),
            "control_period_ms": period_ms,
            "keeps_control_rate": None if period_ms is None else bool(np.median(plan_ms) <= period_ms),
            "mean_action_rate": float(np.mean([r.action_rate for r in results])),
            "mean_jerk": float(np.mean([r.jerk for r in results])),
            "smoothing": self._session.smoothing_summary(),
        }

    def _csv(self) -> str:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        columns = (
            "seed success any_success first_hit final_gap_m plan_ms_median seconds smoothing_ms_median action_rate jerk"
        )
        writer.writerow(columns.split())
        for r in self.results:
            hit = "" if r.first_hit is None else r.first_hit
            writer.writerow(
                [r.seed, int(r.success), int(r.first_hit is not None), hit, f"{r.final_gap:.5f}",
                 f"{np.median(r.plan_ms):.2f}", f"{r.seconds:.2f}",
                 f"{np.median(r.smoothing_ms):.2f}", f"{r.action_rate:.6f}", f"{r.jerk:.4f}"]
            )  # fmt: skip
        return text.getvalue()

    def _print(self, summary: dict[str, Any]) -> None:
        steps, gaps = summary["mean_steps_to_goal"], np.array([result.final_gap for result in self.results])
        period_ms = summary["control_period_ms"]
        shown, unit = world_gap(self._session.env.unwrapped, gaps)
        cells = {
            "success": describe(summary["success_rate"], summary["success_interval_95"]),
            "at goal in some step": describe(summary["any_success_rate"], summary["any_success_interval_95"]),
            "steps to goal": "-" if steps is None else f"{steps:.1f}",
            f"final gap [{unit}]" if unit else "final gap": _shown(float(shown.mean()), unit),
            "ms per plan": f"{summary['plan_ms_median']:.0f}" + (f" of {period_ms:.3g}" if period_ms else ""),
        }
        if self._session.config.smooth or self._session.config.low_pass:
            cells["action rate"] = f"{summary['mean_action_rate']:.4f}"
        table = Table(title=f"{summary['planner']} on {summary['env']}, cost {summary['cost']}")
        for column in cells:
            table.add_column(Text(column), justify="right")
        table.add_row(*cells.values())
        self._console.print(table)
        self._say(self._about_the_episodes())
        smoothing = summary["smoothing"]
        if smoothing is not None:
            self._console.print(
                f"smoothing: {100 * smoothing['accepted_share']:.0f} % of {smoothing['calls']} plans accepted, "
                f"{100 * smoothing['kept_share']:.0f} % handed back smooth by the search, "
                f"{smoothing['risen']} with a higher cost, {smoothing['solver_failures']} solver failures; median ms: "
                f"linearise {smoothing['linearise_ms']:.1f}, solve {smoothing['solve_ms']:.1f}, "
                f"verify {smoothing['verify_ms']:.1f}; built once in {smoothing['build_ms']:.1f}",
                highlight=False,
            )
        if period_ms is not None:
            smoothing_ms = float(np.median(np.concatenate([result.smoothing_ms for result in self.results])))
            self._say(self._about_the_pace(summary["plan_ms_median"], smoothing_ms, period_ms))
        for line in self._notes:
            self._say(line)
        self._say(f"results: {self._folder}/summary.json, episodes.csv, steps.csv, steps.png, distance_to_go.png")

    def _about_the_episodes(self) -> str:
        run, n = self._session.run, len(self.results)
        seeds = f"seeds {run.seed} to {run.seed + n - 1}" if n > 1 else f"seed {run.seed}"
        ends = f", which ends an episode once it lasts {run.hold} steps" if run.hold else ""
        return f"{seeds}; success is being at the goal at the end{ends}; napsp columns explains the others"

    def _about_the_pace(self, plan_ms: float, smoothing_ms: float, period_ms: float) -> str:
        """Whether a robot would have to wait for plans, and how many samples would do."""
        if plan_ms <= period_ms:
            return f"pace: plans take {plan_ms:.1f} ms (median), within the control period of {period_ms:.3g} ms"
        search: Any = self._session.config.search
        enough = int(search.samples * (period_ms - smoothing_ms) / max(plan_ms - smoothing_ms, 1e-9))
        drawn = "samples" in {field.name for field in fields(search)}
        fits = drawn and enough >= search.least_samples(self._session.config.n_proposals)
        advice = f"--samples {enough} would about keep pace here"
        if not drawn:
            advice = "try --model.kind coarse or a shorter --horizon on idle cores"
        elif smoothing_ms >= period_ms:
            advice = f"smoothing alone takes {smoothing_ms:.1f} ms: leave out --smooth, or try a shorter --horizon"
        elif not fits:
            advice = "try --model.kind coarse, a shorter --horizon or fewer --samples on idle cores"
        return (
            f"pace: plans take {plan_ms:.1f} ms (median), the control period is {period_ms:.3g} ms, and the simulation "
            f"waited for them; {advice}"
        )

    def _say(self, line: str) -> None:
        self._console.print(line, highlight=False, soft_wrap=True)


def _shown(gap: float, unit: str) -> str:
    """A gap as people read it; without a unit nobody knows which digits matter."""
    return f"{gap:.1f}" if unit else f"{gap:.3g}"
