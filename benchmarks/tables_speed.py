"""Tables of speed: rollouts, whole plan calls beside other libraries, the learner; each a list of markdown lines."""

from __future__ import annotations

from typing import Any

from benchmarks.cells import AGAIN, RESULTS, read_results
from napsp.storage.files import read_json

SPEED, LEARNER = "rollout_speed_*.json", "learner_speed_*.json"


def json_rows(pattern: str) -> list[dict[str, Any]]:
    """Rows that have a file each."""
    return [read_json(path, AGAIN) for path in sorted(RESULTS.glob(pattern))]


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
        "| task | planning model | samples x horizon | policy proposal | plan / replay (CPU) | plan / raw (CPU) | ms per plan | collection in fetch_reach against stock step, same model |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in json_rows(SPEED):
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
        "Time grows linearly with the number of samples (R² > 0.998 from 16 to 1024 samples at each of two horizons, `--scaling`):",
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


def learner_table() -> list[str]:
    """Speed of the learner."""
    lines = [
        "### Learning speed (`python -m benchmarks.learner_speed`)",
        "",
        "HER + SAC updates per second, relabelling included: same networks, batch, task, device and threads, in turn. *CPU* is how many CPU",
        "seconds ours got per second: below the number of threads the machine was shared. The ratio falls with the machine's speed at",
        "matrix products, which both learners need alike. *cuda* is an H100, the CPU rows with the same torch are one core of its machine: at",
        "batch 256 the GPU does 14 times the updates of that core, at 1024 33 times. *GPU idle* is the share of an update in which no kernel ran.",
        "",
        "| networks | batch | device | threads | torch | matrix products | our losses | ours | Stable-Baselines3 | ratio | share of the matrix-product speed | CPU | GPU idle | revision |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    cpu, idle = "ours_cpu_seconds_per_second", "share_outside_kernels"
    for row in json_rows(LEARNER):
        lines.append(
            f"| {row['hidden']} | {row['batch_size']} | {row.get('device', 'cpu')} | {row['threads']} "
            f"| {row['torch']} | {row.get('matmul_precision', 'highest')} "
            f"| {'compiled' if row.get('compiled') else 'not compiled'} | {row['ours_updates_per_second']:.0f} "
            f"| {row['stable_baselines3_updates_per_second']:.0f} | {row['ours_over_stable_baselines3']:.2f} "
            f"| {row['share_of_matrix_product_speed']:.2f} "
            f"| {f'{row[cpu]:.2f}' if cpu in row else '-'} | {f'{row[idle]:.2f}' if idle in row else '-'} "
            f"| {row['revision']} |"
        )
    return lines
