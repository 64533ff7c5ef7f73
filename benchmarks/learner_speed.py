"""Gradient updates per second of HER + SAC: ours against Stable-Baselines3's.

``python -m benchmarks.learner_speed`` gives both the same networks (SiLU), batch, task, episodes'
length, device and thread count, and runs them in turn. An update draws relabelled transitions and steps
critics, policy, entropy weight and targets. Beside the ratio stands the share of the device's
own matrix-product speed that the arithmetic of an update makes up, and how many CPU seconds each
took per second of the clock: less than a thread's worth means that it waited, for a GPU or for other work.
On CUDA a further figure says for what share of an update's time the GPU ran no kernel.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from benchmarks.cells import report
from benchmarks.command import read_options
from napsp import envs as tasks
from napsp.config import TrainConfig, preset
from napsp.errors import UserError, run_command
from napsp.execution import Execution
from napsp.run import new_learner
from napsp.storage.checkpoint import sizes_of
from napsp.storage.revision import git_revision


@dataclass(frozen=True)
class LearnerSpeedOptions:
    """Measure the learner."""

    env: str = "fetch_wall"
    """Task."""
    width: int = 256
    """Width of the two hidden layers."""
    batch_size: int = 256
    """Transitions per update."""
    updates: int = 200
    """Updates per round."""
    rounds: int = 7
    """Interleaved rounds; figures are medians."""
    device: Literal["auto", "cpu", "cuda"] = "cpu"
    """Where both train, see napsp.train."""
    threads: int = 1
    """CPU threads of both."""
    matmul_precision: Literal["highest", "medium"] = "highest"
    """torch's precision of float32 matrix products, for both; medium multiplies in bfloat16 if it can."""
    compiled: bool = False
    """Compile our losses (napsp.train --compiled); Stable-Baselines3 has no such option."""
    out: Path | None = None
    """JSON file for the figures."""


def ours(config: TrainConfig, execution: Execution) -> Callable[[], object]:
    """One round of our updates."""
    envs = [tasks.make(config.env) for _ in range(config.episodes_per_iteration)]
    return new_learner(config, envs, execution=execution).train_policy


def stable_baselines(config: TrainConfig, execution: Execution) -> Callable[[], object]:
    """One round of Stable-Baselines3's updates."""
    try:
        from stable_baselines3 import SAC, HerReplayBuffer
    except ImportError:
        raise UserError("Stable-Baselines3 is not installed; run: pip install 'napsp[test]'") from None
    n_steps = config.n_warmup_episodes * config.episode_length
    model = SAC(
        "MultiInputPolicy",
        tasks.make(config.env),
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
        batch_size=config.batch_size,
        learning_rate=config.policy.learning_rate,
        gamma=config.policy.discount,
        tau=config.policy.polyak,
        policy_kwargs={"net_arch": list(config.hidden), "activation_fn": torch.nn.SiLU},
        learning_starts=n_steps,
        seed=0,
        device=execution.torch_device,
    )
    model.learn(n_steps)
    return lambda: model.train(config.n_policy_updates, config.batch_size)


def arithmetic(config: TrainConfig, sizes: tuple[int, int, int]) -> float:
    """Floating-point operations of the matrix products of one update."""
    n_observation, n_action, n_goal = sizes
    width = config.hidden[0]
    hidden = width * width
    critic_in, policy_in = n_observation + n_action + n_goal, n_observation + n_goal
    critic, policy = critic_in * width + hidden + width, policy_in * width + hidden + 2 * n_action * width
    # Forward: two passes of the policy, six of a critic. Backward: by weights for two critics and
    # the policy; by inputs for two critics twice and the policy (not into the first layer's inputs).
    forward = 2 * policy + 6 * critic
    weights = 2 * critic + policy
    inputs = 4 * (hidden + width) + 2 * n_action * width + hidden + 2 * n_action * width
    return 2.0 * config.batch_size * (forward + weights + inputs)


def matrix_product_speed(width: int, n_rows: int, device: torch.device) -> float:
    """Floating-point operations per second of one warm product ``(n_rows, width) x (width, width)``."""
    a, b = torch.randn(n_rows, width, device=device), torch.randn(width, width, device=device)
    out, times = torch.empty_like(a), []
    for _ in range(50):
        start = time.perf_counter()
        torch.mm(a, b, out=out)
        _wait(device)
        times.append(time.perf_counter() - start)
    return 2.0 * n_rows * width * width / float(np.median(times))


def kernel_seconds(job: Callable[[], object]) -> float:
    """Seconds that the GPU spends in kernels and copies during a job; profiling slows the job, not the kernels."""
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as record:
        job()
        torch.cuda.synchronize()
    return 1e-6 * sum(event.self_device_time_total for event in record.key_averages())


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize()


def measure(options: LearnerSpeedOptions, config: TrainConfig, execution: Execution) -> dict[str, float]:
    """Medians over interleaved rounds."""
    jobs = {"ours": ours(config, execution), "stable_baselines3": stable_baselines(config, execution)}
    rates: dict[str, list[float]] = {name: [] for name in jobs}
    shares: dict[str, list[float]] = {name: [] for name in jobs}
    peaks, device = [], execution.torch_device
    for job in jobs.values():
        job()  # first call: allocation, and compiling or capturing if wanted
    for _ in range(options.rounds):
        peaks.append(matrix_product_speed(options.width, options.batch_size, device))
        for name, job in jobs.items():
            start, cpu_start = time.perf_counter(), time.process_time()
            job()
            _wait(device)
            seconds = time.perf_counter() - start
            rates[name].append(options.updates / seconds)
            shares[name].append((time.process_time() - cpu_start) / seconds)
    outside = {}
    if device.type == "cuda":
        busy = kernel_seconds(jobs["ours"]) * float(np.median(rates["ours"])) / options.updates
        outside = {"share_outside_kernels": 1.0 - busy}
    ratio = np.array(rates["ours"]) / np.array(rates["stable_baselines3"])
    work = arithmetic(config, sizes_of(tasks.make(config.env)))
    return {
        **{f"{name}_updates_per_second": float(np.median(values)) for name, values in rates.items()},
        "ours_over_stable_baselines3": float(np.median(ratio)),
        "share_of_matrix_product_speed": float(np.median(np.array(rates["ours"]) * work / np.array(peaks))),
        **{f"{name}_cpu_seconds_per_second": float(np.median(values)) for name, values in shares.items()},
        **outside,
    }


def main() -> int:
    """Measure, print, optionally write JSON."""
    options = read_options(LearnerSpeedOptions, "learner_speed")
    execution = Execution(options.device, options.compiled, options.threads)
    torch.set_num_threads(options.threads)
    torch.set_float32_matmul_precision(options.matmul_precision)
    changes = {
        "policy.agent": "sac", "hidden": (options.width, options.width), "batch_size": options.batch_size,
        "n_policy_updates": options.updates, "n_warmup_episodes": 40,
    }  # fmt: skip
    config = preset(options.env, "sparse", changes=changes)
    figures: dict[str, Any] = {
        "env": config.env,
        "hidden": list(config.hidden),
        "batch_size": options.batch_size,
        "device": execution.torch_device.type,
        "threads": options.threads,
        "matmul_precision": options.matmul_precision,
        "compiled": options.compiled,
        "torch": torch.__version__,
        "revision": git_revision(),
        **measure(options, config, execution),
    }
    report(figures, options.out)
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
