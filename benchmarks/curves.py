"""Figures 3 and 5 from published runs: ``python -m benchmarks.curves``.

Figure 3: success and maximum reward over training episodes, all tasks, the paper's four methods and plus. Figure 5:
maximum reward, merging and relaxation rates on pick and place. Lines are interquartile means
over seeds, bands their 95 % bootstrap intervals. A third picture has success on two harder
tasks. Nothing is trained: ``benchmarks.sweep`` does that; cells without a run are said to be
missing.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cells import RESULTS, learning_curves, usual_recipe
from benchmarks.command import read_options
from benchmarks.units import in_unit, unit
from napsp.config import DEFAULT, METHODS, OF_THE_GATE, PAPER, identity_of, idle_options, preset, recipes
from napsp.envs.cards import suite
from napsp.errors import run_command
from napsp.settings import flat, to_dict
from napsp.statistics import interquartile_mean
from napsp.storage.record import save_figure

NAMED = {
    "counts.reached_bits": "one key",
    "policy.min_entropy_weight": "alpha >= {}",
    "bootstrap.stay": "stay {}",
    "temporal.first_arrival": "first arrival",
    "episodes_per_iteration": "{} episodes per iteration",
    "qrl.push_until": "pushed apart up to {:g} steps",
}
"""Options that may differ from the recipe's in a line of its own, where such runs exist, and what they are called."""
SUPERSEDED = ("counts.reached_bits", "policy.min_entropy_weight", "bootstrap.stay")
"""Of these, ways of older versions: such a line is shown until the same one without them is run."""
TABLES_ONLY = ("episodes_per_iteration", "qrl.push_until")
"""Lines that figures leave out."""
PALETTE = ("gray", "orange", "blue", "red", "purple", "brown")
COLORS: dict[str, str] = {method: f"tab:{c}" for method, c in zip(METHODS, PALETTE, strict=True)}
STYLES = ("-", "--", ":", "-.")
TITLES = {
    "success_rate": "success (last step)",
    "any_success_rate": "success (some step)",
    "max_reward": "maximum reward [{unit}]",
    "merging_rate": "merging rate",
    "relaxation_rate": "relaxation rate",
}


@dataclass(frozen=True)
class Line:
    """Runs that ask the same but for seed and number of episodes.

    Attributes:
        method: its name.
        recipe: whose values it has.
        named: options that differ from them, in the order of :data:`NAMED`.
    """

    method: str
    recipe: str = PAPER
    named: tuple[tuple[str, Any], ...] = ()

    @property
    def name(self) -> str:
        """What figures and tables call it."""
        recipe = "" if self.recipe == PAPER else f" + {self.recipe}"
        return ", ".join([self.method + recipe, *(NAMED[option].format(value) for option, value in self.named)])

    @property
    def in_figures(self) -> bool:
        """Whether figures show it."""
        return not any(option in TABLES_ONLY for option, _ in self.named)

    def of_today(self) -> Line:
        """The line without ways of older versions; that of most lines is itself."""
        kept = tuple((option, value) for option, value in self.named if option not in SUPERSEDED)
        return Line(self.method, self.recipe, kept)

    def rank(self) -> tuple[Any, ...]:
        """Sorting key: methods in the paper's order, the paper's recipe first, then by what they are called."""
        return METHODS.index(self.method), self.recipe != PAPER, self.name


_USUAL_OF_ALL = flat(to_dict(DEFAULT))


@lru_cache
def _usual(env: str, method: str, recipe: str) -> dict[str, Any]:
    """What a recipe asks, by dotted names; each of a thousand rows is compared with it."""
    return flat(to_dict(preset(env, method, recipe)))


def line_of(identity: Mapping[str, Any]) -> Line | None:
    """The line of a run that asks this; None if it has an option otherwise that makes no line of its own."""
    asked = {**_USUAL_OF_ALL, **identity}
    env, method = asked["env"], asked["method"]
    idle = {"seed", "recipe", "n_episodes"}
    if method != "ours" or "counts.reached_bits" in identity:
        idle |= set(OF_THE_GATE)  # nobody asks for N(s, a, g), or it had one joint key
    unasked = idle_options(method)
    for recipe in recipes(env):
        usual = _usual(env, method, recipe)
        different = {k for k, v in asked.items() if usual.get(k) != v and not k.startswith(unasked)} - idle
        if different <= NAMED.keys():
            return Line(method, recipe, tuple((option, asked[option]) for option in NAMED if option in different))
    return None


def expected_lines(env: str) -> list[Line]:
    """What a task's comparison is made of: all methods but the yardstick, by its own recipe if it has one."""
    return [Line(method, usual_recipe(env)) for method in METHODS if method != "qrl"]


def full_line_of(identity: Mapping[str, Any]) -> Line | None:
    """As :func:`line_of`, None as well for another number of episodes than the task's own."""
    line, n_episodes = line_of(identity), identity.get("n_episodes", DEFAULT.n_episodes)
    if line is None or _usual(identity["env"], line.method, line.recipe)["n_episodes"] != n_episodes:
        return None
    return line


def is_current(line: Line, measured: Collection[Line]) -> bool:
    """Whether a line is of today, or of an older version while today's like it is not among those measured."""
    return line == line.of_today() or line.of_today() not in measured


def current_runs(env: str) -> dict[Line, list[dict[str, Any]]]:
    """Published runs of a task by line, as far as its options have a name: of the most episodes in each line."""
    longest: dict[tuple[Line, int], dict[str, Any]] = {}
    for run in sorted(learning_curves(env), key=lambda run: run["config"]["n_episodes"]):
        line = line_of(identity_of(run["config"]))
        if line is not None:
            longest[line, run["seed"]] = run
    found: dict[Line, list[dict[str, Any]]] = defaultdict(list)
    for (line, _), run in sorted(longest.items(), key=lambda item: (item[0][0].rank(), item[0][1])):
        found[line].append(run)
    for line, group in found.items():  # seeds of one length: a mean over others would compare different amounts
        most = max(run["config"]["n_episodes"] for run in group)
        found[line] = [run for run in group if run["config"]["n_episodes"] == most]
    return {line: runs for line, runs in found.items() if is_current(line, found)}


def recorded(runs: list[dict[str, Any]], column: str) -> list[dict[str, Any]]:
    """Runs that have a column: the oldest ones lack the maximum reward."""
    return [run for run in runs if column in run["curve"][-1]]


def over_seeds(runs: list[dict[str, Any]], column: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Episodes ``(n,)``, interquartile means ``(n,)`` and interval ends ``(2, n)`` (NaN with too few seeds).

    Over the runs that :func:`recorded` the column.
    """
    runs = recorded(runs, column)
    values: dict[float, list[float]] = defaultdict(list)
    for run in runs:
        for row in run["curve"]:
            if column in row:
                values[row["episodes"]].append(in_unit(run["config"]["env"], column, row[column]))
    episodes = sorted(e for e, v in values.items() if len(v) == len(runs))
    summaries = [interquartile_mean(values[e]) for e in episodes]
    ends = [interval or (np.nan, np.nan) for _, interval in summaries]
    return np.array(episodes), np.array([mean for mean, _ in summaries]), np.array(ends).reshape(-1, 2).T


def draw(axis: Any, env: str, runs: Mapping[Line, list[dict[str, Any]]], column: str) -> None:
    """One panel: a curve per line, of the method's colour; a recipe that all lines have stands in the title."""
    in_title = {line.recipe for line in runs if line.in_figures}
    in_title = in_title if len(in_title) == 1 else set()
    drawn: dict[str, int] = defaultdict(int)
    for line in runs:
        episodes, means, ends = over_seeds(runs[line], column) if line.in_figures else ((), (), ())
        if len(episodes):
            name = replace(line, recipe=PAPER).name if line.recipe in in_title else line.name
            label, color = f"{name} ({len(recorded(runs[line], column))})", COLORS[line.method]
            style = STYLES[drawn[line.method] % len(STYLES)]
            axis.plot(episodes, means, color=color, label=label, linewidth=1.2, linestyle=style)
            axis.fill_between(episodes, *ends, color=color, alpha=0.15, linewidth=0)
            drawn[line.method] += 1
    axis.set_title(" + ".join([env, *(in_title - {PAPER})]), fontsize=9)
    axis.set(xlabel="episodes", ylabel=TITLES[column].format(unit=unit(env)))
    if axis.lines:
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.22), "frameon": False}  # off the data
        axis.legend(fontsize=6, title="method (seeds)", title_fontsize=6, ncol=2, **below)
    else:
        axis.text(0.5, 0.5, "not run", ha="center", transform=axis.transAxes)


def grid(panels: list[tuple[str, str]], n_columns: int, path: Path) -> None:
    """Draw (task, column) panels into one picture."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    n_rows = -(-len(panels) // n_columns)
    figure, axes = plt.subplots(n_rows, n_columns, figsize=(3.1 * n_columns, 3.0 * n_rows), layout="constrained")
    for axis, (env, column) in zip(np.ravel(axes), panels, strict=True):
        draw(axis, env, current_runs(env), column)
    save_figure(figure, path)
    print(f"picture: {path}")


@dataclass(frozen=True)
class CurveOptions:
    """Draw figures 3 and 5, and the curves of two harder tasks, from results/runs; there is nothing to choose."""


def main() -> int:
    """Draw the figures; name the cells that were not run."""
    read_options(CurveOptions, "curves")
    for env in suite("paper"):
        missing = [line.name for line in expected_lines(env) if line not in current_runs(env)]
        if missing:
            print(f"{env}: not run: {', '.join(missing)}")
    columns = ("success_rate", "max_reward")
    grid([(env, column) for column in columns for env in suite("paper")], len(suite("paper")), RESULTS / "figure3.png")
    grid([(env, "success_rate") for env in suite("harder")], len(suite("harder")), RESULTS / "harder_tasks.png")
    rates = ("max_reward", "merging_rate", "relaxation_rate")
    grid([("fetch_pick_place", column) for column in rates], 3, RESULTS / "figure5.png")
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
