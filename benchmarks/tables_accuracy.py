"""Tables of how true distances are; markdown lines."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

from benchmarks.cells import RESULTS, read_results, training_of
from benchmarks.curves import full_line_of, line_of
from benchmarks.distance_accuracy import BINS, AccuracyOptions, usual_starts
from benchmarks.tables_training import over_seeds
from napsp.config import DEFAULT

ACCURACY = {
    "spearman": "Spearman",
    "ratio_cv": "ratio CV",
    "mean_ratio": "mean ratio",
    "triangle_rate": "triangles violated",
    "triangle_rate_step": "by a step",
    "distance_at_goal": "d at the goal",
    "slope_at_goal": "slope around it",
    "best_action_rate": "best action",
    "best_action_rate_by_chance": "by chance",
    "spearman, of the task": "Spearman, of the task",
    "spearman, onwards": "onwards",
    "spearman, backwards": "backwards",
    "spearman, last room": "last room",
}


def accuracy_groups() -> dict[tuple[str, str], list[dict[str, str]]]:
    """Rows of all training seeds, by task and method; a method of other than the task's episodes is named with them."""
    groups: dict[tuple[str, str], list[dict[str, str]]] = {}
    for row in read_results(RESULTS / "distance_accuracy.csv"):
        training = training_of(row)
        line = line_of(training) if training else None
        usual = (str(usual_starts(row["env"])), str(AccuracyOptions.n_goals))
        if (row["n_starts"], row["n_goals"]) in (usual, ("", "")) and (line is not None or training is None):
            name = line.name if line else row["method"]
            if training and full_line_of(training) is None:
                name += f", {training.get('n_episodes', DEFAULT.n_episodes)} episodes"
            if row.get("hold", "") not in ("", "1"):
                name += f", to arrivals held {row['hold']} steps ({row['n_ways']} ways)"
            groups.setdefault((row["env"], name), []).append(row)
    return groups


def _cells(group: list[dict[str, str]], columns: Iterable[str]) -> list[str]:
    """Figures of a line over its training seeds, those that were measured."""
    values = {k: [float(row[k]) for row in group if row.get(k) not in (None, "", "nan")] for k in columns}
    return [over_seeds(found, len(group), 3 if "spearman" in k else 2) for k, found in values.items()]


def accuracy_table() -> list[str]:
    """Distances against exact ones, and against the best known steps."""
    lines = [
        "### Distance accuracy (`python -m benchmarks.distance_accuracy --env point_maze`)",
        "",
        "In mazes d(s, a, g) for states at rest and goals anywhere, balanced over the rooms, and uniform actions, against exact",
        "shortest-path steps over the real dynamics (breadth-first search with MuJoCo steps as edges, 1 % above what cells half as large",
        "find; in the long maze from 16 starts, 2 %). *Ratio* is d over the truth,",
        "*triangles violated* the share of random triples with d(x, z) > d(x, y) + d(y, z), *slope* what d rises by with a step of truth",
        "within five of the goal, *best action* how often the action of least d among three is a truly best one, *of the task* are pairs of",
        "its own starts and goals, which are in everybody's replay, *onwards* and *backwards* pairs along and against the chain of rooms from the start, *last",
        "room* pairs with the room that episodes of the task never need. In other tasks the truth is an upper bound: the fewest",
        "steps that any planner needed (`python -m benchmarks.best_known`), for states on these ways, to the first arrival or, where a",
        "line says so, to one that is held. Over training seeds: interquartile mean and 95 % bootstrap interval.",
        "",
        "![Estimated over true steps on the maze, of every method](results/distance_accuracy_point_maze.png)",
        "",
        "![Estimated over true steps of the straight line and of plus in the long maze](results/distance_accuracy_point_maze_long.png)",
        "",
        "`python -m benchmarks.distance_maps` draws steps to two goals over the maze, by the shortest path, the straight line and the models that ship:",
        "",
        "![Steps to two goals over the maze](results/distance_maps_point_maze.png)",
        "",
        f"| task | method | seeds | {' | '.join(ACCURACY.values())} |",
        f"|---|---|---|{'---|' * len(ACCURACY)}",
    ]
    for (env, name), group in sorted(accuracy_groups().items()):
        seeds = len(group) if group[0]["seed"] else "-"
        lines.append(f"| {env} | {name} | {seeds} | {' | '.join(_cells(group, ACCURACY))} |")
    return lines


PAIRS = {
    "spearman, own action": "Spearman, own action",
    "mean_ratio, own action": "mean ratio, own action",
    "spearman, from the start": "Spearman, first states",
    "mean_ratio, from the start": "mean ratio, first states",
    "spearman, from the start, own action": "Spearman, first states, own action",
    "mean_ratio, from the start, own action": "mean ratio, first states, own action",
}


def pairs_table() -> list[str]:
    """Distances outside mazes with the model's own action, and of first states alone."""
    lines = [
        "### Distances of pairs, and of first states (`python -m benchmarks.distance_accuracy --env claw`)",
        "",
        "Of learned distances in *Distance accuracy*, outside mazes. There d(s, a, g) has the way's own action, which is worth its steps if the way's others follow; a model",
        "whose policy goes on otherwise says what that takes. *Own action* is d(s, g): the action is the policy's. *First states* are those that episodes begin in; the others lie on",
        "the ways, which plus chose: of the claw and of pick and place over its wall with the model that ships, of the others with earlier ones.",
        "",
        f"| task | method | seeds | {' | '.join(PAIRS.values())} |",
        f"|---|---|---|{'---|' * len(PAIRS)}",
    ]
    for (env, name), group in sorted(accuracy_groups().items()):
        if any(row["n_starts"] for row in group) or not group[0]["seed"]:
            continue
        lines.append(f"| {env} | {name} | {len(group)} | {' | '.join(_cells(group, PAIRS))} |")
    return lines


def error_table() -> list[str]:
    """What d is off by, near and far."""
    bins = list(itertools.pairwise(BINS))
    heads = [f"{low} to {high} steps" if high < BINS[-1] else f"over {low} steps" for low, high in bins]
    lines = [
        "### Errors of distances by true steps",
        "",
        "Mean of d less the truth, in steps, by how far the truth is; rows and truth are those of the table above.",
        "",
        f"| task | method | {' | '.join(heads)} |",
        f"|---|---|{'---|' * len(heads)}",
    ]
    for (env, name), group in sorted(accuracy_groups().items()):
        cells = []
        for low, high in bins:
            column = f"mean error, {low} to {high} steps"
            cells.append(over_seeds([float(row[column]) for row in group if row.get(column)], len(group), 1))
        lines.append(f"| {env} | {name} | {' | '.join(cells)} |")
    return lines
