"""All cells of the paper's comparison: ``python -m benchmarks.sweep --jobs 2``.

A cell is one task, method and seed. Cells whose curve of the same configuration lies in ``results/runs``
are skipped, a killed one is resumed, and any number of processes - started by ``--jobs``, by hand, or by
Ray on several machines with a shared folder - work on the same list without meeting.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch

from benchmarks.cells import ROWS, cell_name, published, trained, usual_recipe
from benchmarks.command import read_options
from napsp import envs as tasks
from napsp.config import METHODS, TrainConfig, preset
from napsp.envs.cards import suite
from napsp.errors import UserError, run_command
from napsp.execution import Execution
from napsp.storage.lock import BusyError


@dataclass(frozen=True)
class SweepOptions:
    """Train every cell of envs x methods x seeds whose curve is not in results/runs yet."""

    envs: tuple[str, ...] = suite("paper")
    """Tasks."""
    methods: tuple[str, ...] = METHODS
    """Methods."""
    recipe: str | None = None
    """paper or manipulation, see napsp.train; default manipulation for pick and place, paper for all others."""
    seeds: int = 3
    """Training seeds 0 .. seeds - 1."""
    n_episodes: int | None = None
    """Training episodes of every cell; None takes each task's own."""
    first_arrival: bool = False
    """Train ours with labels of first arrival, see napsp.train; the other methods stay as they are."""
    episodes_per_iteration: int | None = None
    """Episodes collected per iteration; None takes each task's own. Updates are per iteration."""
    compiled: bool = False
    """Compile the losses, see napsp.train: faster cells. Each update differs in rounding only; runs drift apart."""
    device: Literal["auto", "cpu", "cuda"] = "cpu"
    """Where the networks are trained, see napsp.train; many processes can share one GPU."""
    again: bool = False
    """Also train cells whose curves are in results/runs already; those stay as they are there."""
    jobs: int = 1
    """Processes on this machine; one single-threaded process per core is fastest."""
    backend: Literal["local", "ray"] = "local"
    """local: processes on this machine. ray: tasks of a Ray cluster whose machines share this
    folder (pip install 'napsp[ray]')."""


def cells(options: SweepOptions) -> Iterator[TrainConfig]:
    """Configurations, all tasks and methods of a seed before the next seed."""
    for seed in range(options.seeds):
        for env in options.envs:
            for method in options.methods:
                changes: dict[str, Any] = {}
                if options.first_arrival and method == "ours":
                    changes["temporal.first_arrival"] = True
                for name in ("n_episodes", "episodes_per_iteration"):
                    if getattr(options, name) is not None:
                        changes[name] = getattr(options, name)
                recipe = options.recipe or usual_recipe(tasks.canonical_name(env))
                yield preset(env, method, recipe, changes, seed=seed)


def execution(options: SweepOptions) -> Execution:
    """How every cell is trained: on one thread, for that is fastest with one process per core."""
    return Execution(options.device, options.compiled)


def work(options: SweepOptions) -> None:
    """Train cell after cell, leaving out those that others work on."""
    for config in cells(options):
        if published(config) and not options.again:
            print(f"{cell_name(config)}: already in {ROWS}", flush=True)
            continue
        try:
            trained(config, execution(options), wait=False)
        except BusyError:
            print(f"{cell_name(config)}: in work elsewhere", flush=True)


def work_in_processes(options: SweepOptions, arguments: list[str]) -> int:
    """Run this command in several processes and wait for all of them; on Ctrl-C let them save, and return 130."""
    command = [sys.executable, "-m", "benchmarks.sweep", *arguments, "--jobs", "1"]
    # In groups of their own, so that whoever interrupts this process, by the terminal or not, each hears of it once.
    workers = [subprocess.Popen(command, process_group=0) for _ in range(options.jobs)]
    interrupted = False
    while True:
        try:
            statuses = [worker.wait() for worker in workers]
            break
        except KeyboardInterrupt:
            interrupted = True
            for worker in workers:
                if worker.poll() is None:
                    worker.send_signal(signal.SIGINT)
    if interrupted:
        return 130
    return max(status if status >= 0 else 128 - status for status in statuses)  # a signal as a shell reports it


def work_on_ray(options: SweepOptions) -> None:
    """One Ray task with one core per cell."""
    try:
        import ray  # type: ignore[import-not-found]
    except ImportError:
        raise UserError("Ray is not installed; run: pip install 'napsp[ray]'") from None

    folder = Path.cwd()

    def task(config: TrainConfig) -> None:
        os.chdir(folder)
        torch.set_num_threads(1)
        trained(config, execution(options))

    ray.init(ignore_reinit_error=True)  # the cluster of RAY_ADDRESS, or this machine
    remote = ray.remote(num_cpus=1)(task)
    ray.get([remote.remote(config) for config in cells(options) if options.again or not published(config)])


def main() -> int:
    """Run the sweep."""
    options = read_options(SweepOptions, "sweep")
    unknown = set(options.methods) - set(METHODS)
    if unknown:
        raise UserError(f"unknown method {unknown.pop()!r}; choose from: {', '.join(METHODS)}")
    list(cells(options))  # unknown tasks and recipes fail before any work
    torch.set_num_threads(1)
    if options.backend == "ray":
        work_on_ray(options)
    elif options.jobs > 1:
        return work_in_processes(options, sys.argv[1:])
    else:
        work(options)
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
