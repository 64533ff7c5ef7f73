"""Writes the README's results from the rows in ``results/``: ``python -m benchmarks.readme``."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path

from benchmarks.cells import RESULTS, read_results
from benchmarks.curves import LINES, NAMED, current_runs, line_of
from benchmarks.sweep import PAPER_TASKS
from napsp.checkpoint import write_atomically
from napsp.config import METHODS
from napsp.errors import run_command
from napsp.presets import preset
from napsp.statistics import describe, interquartile_mean, wilson_interval

README = Path("README.md")
START, END = "<!-- results:start -->", "<!-- results:end -->"


def _current(name: str) -> list[dict[str, str]]:
    """Rows of the present presets; rows of superseded settings stay in the file only."""
    rows = read_results(RESULTS / name)
    hashes = {(r["env"], m): preset(r["env"], method=m).hash() for r in rows for m in METHODS}
    return [r for r in rows if r["method"] not in METHODS or r["config_hash"] == hashes[r["env"], r["method"]]]


def cost_table() -> list[str]:
    """Costs for planning, pooled over training seeds."""
    groups: dict[tuple[str, str], list[dict[str, str]]] = defaultdict(list)
    for row in read_results(RESULTS / "distance_as_cost.csv"):
        hashes = {preset(row["env"], method=method).hash() for method in METHODS}
        current = not row["training_seed"] or row["training_hash"] in hashes
        if current and (row["samples"], row["episodes"]) == ("64", "50"):
            groups[row["env"], row["variant"]].append(row)
    lines = [
        "### Which cost plans (`python -m benchmarks.distance_as_cost --env NAME`)",
        "",
        "MPPI, 64 samples, fresh episode seeds, success in the last step with its 95 % Wilson interval over all episodes;",
        "episodes of one checkpoint share its training, so read the rates per training seed as well.",
        "",
        "| task | cost | success | per training seed | at goal in some step | steps to goal |",
        "|---|---|---|---|---|---|",
    ]
    for (env, variant), rows in groups.items():
        n = sum(int(row["episodes"]) for row in rows)
        successes = sum(round(float(row["success_rate"]) * int(row["episodes"])) for row in rows)
        any_rate = sum(float(row["any_success_rate"]) for row in rows) / len(rows)
        steps = [float(row["mean_steps_to_goal"]) for row in rows if row["mean_steps_to_goal"]]
        seeds = ", ".join(f"{float(row['success_rate']):.2f}" for row in rows) if rows[0]["training_seed"] else "-"
        lines.append(
            f"| {env} | {variant} | {describe(successes / n, wilson_interval(successes, n))} | {seeds} | {any_rate:.2f} "
            f"| {f'{sum(steps) / len(steps):.1f}' if steps else '-'} |"
        )
    return lines


def training_table() -> list[str]:
    """Final evaluation of the shipped checkpoints."""
    lines = [
        "### Shipped checkpoints",
        "",
        "| task | command | episodes | wall minutes, machine shared | success | d at the goal |",
        "|---|---|---|---|---|---|",
    ]
    for path in sorted(Path("napsp/checkpoints").glob("*/training.json")):
        record = json.loads(path.read_text())
        final = record["final"]
        lines.append(
            f"| {path.parent.name} | `{record['command']}` | {record['episodes']:.0f} | {record['minutes']:.1f} "
            f"| {final['success_rate']:.2f} | {final.get('distance_at_goal', float('nan')):.1f} |"
        )
    return lines


def learning_table() -> list[str]:
    """Final evaluation of every cell of the paper's comparison, over training seeds."""
    lines = [
        "### The paper's comparison (`python -m benchmarks.sweep`, `python -m benchmarks.curves`)",
        "",
        "![Learning curves of all tasks and methods](results/figure3.png)",
        "",
        "Last evaluation of each training run, on goals that all methods and seeds share; interquartile mean over seeds with its",
        "95 % bootstrap interval (three seeds or more). *Success* is being at the goal in the last step, *maximum reward* the least",
        "distance to the goal in an episode, negated. *First arrival* is `--first-arrival`, an option that the paper does not have.",
        "",
        "| task | method | seeds | episodes | success | some-step success | maximum reward [m] | success 1.0 first at episode |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for env in PAPER_TASKS:
        runs = current_runs(env)
        for method, options in LINES.items():
            if method in NAMED and not runs.get(method):
                continue
            cells = ["not run", *[""] * 5]
            if runs.get(method):
                last = [run["curve"][-1] for run in runs[method]]
                summaries = [
                    describe(*interquartile_mean([row[k] for row in last])) if all(k in row for row in last) else "-"
                    for k in ("success_rate", "any_success_rate", "max_reward")
                ]
                first = [_first_full(run["curve"]) for run in runs[method]]
                wanted = preset(env, **options).n_episodes
                done = min(int(row["episodes"]) for row in last)
                length = str(done) if done >= wanted else f"{done} of {wanted}"
                cells = [str(len(last)), length, *summaries, ", ".join(first)]
            lines.append(f"| {env} | {method} | {' | '.join(cells)} |")
    return lines


def _first_full(curve: list[dict[str, float]]) -> str:
    full = [row["episodes"] for row in curve if row["success_rate"] == 1.0]
    return f"{full[0]:.0f}" if full else "never"


def accuracy_table() -> list[str]:
    """Learned distances against exact ones."""
    lines = [
        "### Distance accuracy (`python -m benchmarks.distance_accuracy --env point_maze`)",
        "",
        "d(s, a, g) for states at rest anywhere, uniform actions and goals, against exact shortest-path steps over the real",
        "dynamics (breadth-first search with MuJoCo steps as edges). *Task pairs* lead from the start room to the goal room.",
        "",
        "| task | method | seed | Spearman | Pearson | ratio CV | mean ratio | Spearman, task pairs |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in _current("distance_accuracy.csv"):
        figures = [f"{float(row[k]):.2f}" for k in ("spearman", "pearson", "ratio_cv", "mean_ratio", "task_spearman")]
        lines.append(f"| {row['env']} | {row['method']} | {row['seed'] or '-'} | {' | '.join(figures)} |")
    return lines


def coverage_table() -> list[str]:
    """State coverage of the four methods."""
    lines = [
        "### State coverage, figure 6 (`python -m benchmarks.coverage`)",
        "",
        "![State coverage of the four methods in the long maze](results/coverage_point_maze_long.png)",
        "",
        "| task | method | seed | episodes | house covered | goal room covered | success | any-step success |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in _current("coverage.csv"):
        names = ("coverage", "goal_room_coverage", "success_rate", "any_success_rate")
        figures = [f"{float(row[k]):.2f}" for k in names]
        lines.append(f"| {row['env']} | {row['method']} | {row['seed']} | {row['episodes']} | {' | '.join(figures)} |")
    return lines


def speed_table() -> list[str]:
    """Plan throughput."""
    lines = [
        "### Speed (`python -m benchmarks.rollout_speed --env fetch_wall`)",
        "",
        "One run, 2 cores; ratios of total times over the states of a planned episode. *Replay* is the very same motions in one",
        "`mujoco.rollout` call on the environment's model (or its coarse copy), *raw* the same number of steps with constant controls.",
        "Plans leave out of the model what only pictures show, so they may come out ahead of both. The policy's proposal is on by default",
        "with `--cost distance`.",
        "",
        "| task | planning model | samples x horizon | policy proposal | plan / replay (CPU) | plan / raw (CPU) | ms per plan | collection against stock step, same model |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for path in sorted(RESULTS.glob("rollout_speed_*.json")):
        row = json.loads(path.read_text())
        collection = row.get("collection_speedup_same_model")
        lines.append(
            f"| {row['env']} | {row.get('planning_model', 'exact')} | {row['samples']} x {row['horizon']} "
            f"| {'yes' if row.get('proposals') else 'no'} | {row['plan_over_replay_cpu']:.2f} "
            f"| {row['plan_over_raw_cpu']:.2f} | {row['plan_ms']:.0f} | {f'{collection:.2f}x' if collection else '-'} |"
        )
    return lines


def throughput_table() -> list[str]:
    """Plan throughput beside other libraries."""
    rows = read_results(RESULTS / "throughput.csv")
    lines = [
        "### Whole plan calls beside other libraries (`python -m benchmarks.throughput`)",
        "",
        "Same model, samples, control steps, white noise and straight-line cost, interleaved in one run; 1 is the speed of bare `mujoco.rollout` on",
        "the planner's very own motions (*replay*) or with constant controls (*raw*, which meets other contacts). What a library cannot express,",
        "or what was not installed, is said. All get the environment's model; that napsp plans in a copy without visual shapes is part of its speed.",
        "Time grows linearly with samples and horizon (R² > 0.999 from 16 to 1024 samples, `--scaling`):",
        "",
        "![Time per plan against samples](results/throughput_scaling_fetch_wall.png)",
        "",
        "| task | samples x horizon | planner | plan / replay (CPU) | plan / replay (wall) | plan / raw (CPU) | CPU ms per plan |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        names = ("over_replay_cpu", "over_replay_wall", "over_raw_cpu", "cpu_ms")
        cells = [f"{float(row[n]):.2f}" if row[n] else "-" for n in names[:3]] + [row["cpu_ms"] or row["note"]]
        lines.append(f"| {row['env']} | {row['samples']} x {row['horizon']} | {row['planner']} | {' | '.join(cells)} |")
    return lines if rows else []


def smoothing_table() -> list[str]:
    """Planners with and without the smoothing layer."""
    lines = [
        "### Smoothing (`python -m benchmarks.smoothing --env NAME`)",
        "",
        "The same fresh episodes, one thread. *Action rate* is the mean squared change from one action to the next; *accepted*",
        "the share of plans that the layer made smoother, + of those that it had made at an earlier step and the search handed back",
        "unchanged; *risen* counts accepted plans whose true cost went up.",
        "",
        "| task | planner | proposals | variant | success | first hit | action rate | jerk | accepted | risen | search + smoothing [ms] |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    rows = read_results(RESULTS / "smoothing.csv")
    for row in sorted(rows, key=lambda row: (row["env"], row["planner"], row["proposals"])):
        hits = [float(hit) for hit in row["first_hits"].split() if hit != "-"]
        n, rate = int(row["episodes"]), float(row["success_rate"])
        shares = [f"{float(row[name]):.2f}" for name in ("accepted_share", "kept_share") if row.get(name)]
        lines.append(
            f"| {row['env']} | {row['planner']} | {'yes' if row['proposals'] == 'True' else 'no'} | {row['variant']} "
            f"| {describe(rate, wilson_interval(round(rate * n), n))} | {sum(hits) / max(1, len(hits)):.1f} "
            f"| {float(row['action_rate']):.4f} | {float(row['jerk']):.1f} | {' + '.join(shares) or '-'} | {row.get('risen') or '-'} "
            f"| {float(row['search_ms']):.0f} + {float(row['smoothing_ms']):.0f} |"
        )
    return lines


def versus_table() -> list[str]:
    """The policy against planners with the same distance."""
    rows = []
    for row in read_results(RESULTS / "policy_vs_mpc.csv"):
        training = line_of(row["env"], row["training_hash"], int(row["training_episodes"]))
        if training is not None:
            rows.append(row | {"training": training})
    lines = [
        "### Policy against planner (`python -m benchmarks.policy_vs_mpc --env NAME`)",
        "",
        "The same distance, the same fresh episodes; *budget* is simulated plans per control step over all refinements.",
        "",
        "| task | training | episodes | planner | policy's rollout among the samples | budget | success | steps to goal | action rate | ms per plan |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        n, rate = int(row["episodes"]), float(row["success_rate"])
        policy = row["planner"] == "policy"
        steps = f"{float(row['mean_steps_to_goal']):.1f}" if row["mean_steps_to_goal"] else "-"
        lines.append(
            f"| {row['env']} | {row['training']} | {row['training_episodes']} | {row['planner']} "
            f"| {'-' if policy else 'yes' if row['proposals'] == '1' else 'no'} | {'-' if policy else row['budget']} "
            f"| {describe(rate, wilson_interval(round(rate * n), n))} | {steps} "
            f"| {f'{float(smooth):.3f}' if (smooth := row.get('action_rate')) else '-'} | {float(row['plan_ms_median']):.0f} |"
        )
    for path in sorted(RESULTS.glob("policy_vs_mpc_*.png")):
        lines += ["", f"![Success of policy and planners on {path.stem.removeprefix('policy_vs_mpc_')}]({path})"]
    return lines if rows else []


def learner_table() -> list[str]:
    """Speed of the learner."""
    lines = [
        "### Learning speed (`python -m benchmarks.learner_speed`)",
        "",
        "HER + SAC updates per second, relabelling included: same networks, batch, task and threads, in turn.",
        "",
        "| networks | batch | threads | matrix products | ours | Stable-Baselines3 | ratio | share of the matrix-product speed |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for path in sorted(RESULTS.glob("learner_speed_*.json")):
        row = json.loads(path.read_text())
        lines.append(
            f"| {row['hidden']} | {row['batch_size']} | {row['threads']} | {row.get('matmul_precision', 'highest')} | {row['ours_updates_per_second']:.0f} "
            f"| {row['stable_baselines3_updates_per_second']:.0f} | {row['ours_over_stable_baselines3']:.2f} "
            f"| {row['share_of_matrix_product_speed']:.2f} |"
        )
    return lines


def main() -> int:
    """Replace the part of the README between the two markers."""
    tables = (
        cost_table, versus_table, smoothing_table, training_table, learning_table, accuracy_table, coverage_table,
        speed_table, throughput_table, learner_table,
    )  # fmt: skip
    body = "\n\n".join("\n".join(lines) for table in tables if (lines := table()))
    text = README.read_text()
    before, after = text.split(START)[0], text.split(END)[1]
    write_atomically(README, f"{before}{START}\n\n{body}\n\n{END}{after}".encode())
    print(f"{README} updated from {RESULTS}/")
    return 0


if __name__ == "__main__":
    run_command(main)
