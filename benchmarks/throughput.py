"""How fast is a whole plan call beside raw ``mujoco.rollout`` and other planning libraries?

``python -m benchmarks.throughput`` plans with every library at the same states of an episode: same MuJoCo model,
samples, control steps, threads, white noise and straight-line cost, interleaved in one run in a rotating order. All get
the environment's model; that this package plans in a copy without cameras and visual shapes is part of what is
timed. Each is compared with two ``mujoco.rollout`` calls that plan nothing, in the environment's model:

* raw: constant controls, those of the state;
* replay: the very motions that the planner simulated, which may meet more or fewer contacts than raw's.

Speed over either is its total time over that of the planner. Rows go to ``results/throughput.csv``; a library that is
not installed, or cannot express a task, has a row that says so. ``--scaling`` asks instead whether the time of
a plan grows linearly (:mod:`benchmarks.scaling`).
"""

from __future__ import annotations

import importlib.metadata
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch

from benchmarks import scaling
from benchmarks.batch_simulator import Problem, UnavailableError
from benchmarks.cells import RESULTS, replace_results
from benchmarks.command import read_options
from benchmarks.machine import machine
from benchmarks.peers import PEERS, Peer
from benchmarks.raw_rollout import RawRollout
from benchmarks.rollout_speed import Replay, clocked
from mpc.rollout import Followed, Trajectories
from napsp import envs as tasks
from napsp.envs.dynamics import get_state
from napsp.errors import UserError, run_command
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session

RAW, OURS = "raw", "napsp"
COLUMNS = ("env", "planner", "samples", "horizon")
"""What identifies a row."""
Clocks = list[tuple[float, float]]
"""Wall and CPU seconds of every call."""


@dataclass(frozen=True)
class ThroughputOptions:
    """Compare plan throughput with other libraries, or measure how it grows with the samples."""

    env: tuple[str, ...] = ("point_maze", "claw", "fetch_wall")
    """Tasks."""
    samples: tuple[int, ...] | None = None
    """Plans per call; default 64, with --scaling 16, 32, ..., 1024."""
    horizon: tuple[int, ...] | None = None
    """Control steps per plan; default the task's own, with --scaling also twice as many."""
    rounds: int = 15
    """Calls of each planner, one per control step of the episode."""
    threads: int | None = None
    """Simulation threads; default all cores. (judo takes one per sample.)"""
    scaling: bool = False
    """Measure time and memory of napsp's plans against their number."""
    cost: str = "distance"
    """Cost of the plans with --scaling: distance (with the policy's proposals) or euclidean."""


class RecordedPlanner:
    """napsp's MPPI as a job to be timed; keeps what it simulated."""

    def __init__(self, env: str, samples: int, horizon: int, threads: int | None) -> None:
        changes = {"env": env, "cost": "euclidean", "horizon": horizon}
        search = {"search.samples": samples, "search.noise_correlation": 0.0, "search.finest": 1.0}  # as its peers
        self.session = Session.open(PlanConfig.of("mppi", changes | search), RunOptions(threads=threads))
        self.world, self.engine = self.session.env.unwrapped, self.session.controller.engine
        self.actions, self.action = np.empty(0), np.empty(0)
        self._simulate = self.engine.rollout
        self.engine.rollout = self._record

    def _record(self, state: np.ndarray, actions: np.ndarray, known: Sequence[Followed] = ()) -> Trajectories:
        self.actions = actions
        return self._simulate(state, actions, known)

    def plan(self, state: np.ndarray, observation: dict[str, np.ndarray]) -> None:
        """Plan."""
        self.action = self.session.controller.plan_from(state, observation).action


def open_peers(problem: Problem) -> tuple[dict[str, Peer], dict[str, str]]:
    """Peers that can plan, and for each of the others why it cannot."""
    peers: dict[str, Peer] = {}
    notes: dict[str, str] = {}
    for name, peer in PEERS.items():
        try:
            peers[name] = peer(problem)
        except UnavailableError as error:
            notes[name] = str(error)
    return peers, notes


def check_physics(peers: dict[str, Peer], problem: Problem) -> None:
    """Refuse to compare with a peer that simulated more or less than napsp.

    Raises:
        RuntimeError: the last plan of a peer had another number of physics steps.
    """
    expected = problem.samples * problem.horizon * problem.world.dynamics.substeps
    for name, peer in peers.items():
        if peer.physics_steps != expected:
            raise RuntimeError(f"{name} simulated {peer.physics_steps} physics steps instead of {expected}")


def compare(env: str, samples: int, horizon: int, options: ThroughputOptions) -> list[dict[str, Any]]:
    """One row per planner."""
    ours = RecordedPlanner(env, samples, horizon, options.threads)
    world, engine = ours.world, ours.engine
    observation, _ = ours.session.env.reset(seed=0)
    state = get_state(world.model, world.data)
    ours.plan(state, observation)  # forks its helpers, before other libraries start threads
    problem = Problem(world, samples, horizon, ours.session.config.search.noise_scale, engine.n_threads)
    peers, notes = open_peers(problem)
    for peer in peers.values():
        peer.plan(state, observation)  # first call: allocation
    planners: dict[str, Any] = {OURS: ours, **peers}
    names = [RAW, *planners]
    times: dict[str, Clocks] = {name: [] for name in names}
    replays: dict[str, Clocks] = {name: [] for name in planners}
    for i in range(options.rounds):
        state = get_state(world.model, world.data)
        raw = RawRollout(world.dynamics, engine.n_threads, state, samples, horizon)
        raw()
        jobs: dict[str, Any] = {name: partial(planner.plan, state, observation) for name, planner in planners.items()}
        jobs[RAW] = raw
        for name in names[i % len(names) :] + names[: i % len(names)]:
            times[name].append(clocked(jobs[name], engine))
        raw.close()
        check_physics(peers, problem)
        for name, planner in planners.items():
            replay = Replay(world.dynamics, state, planner.actions, engine.n_threads)
            replays[name].append(clocked(replay, engine))
            replay.close()
        observation, *_ = ours.session.env.step(ours.action)
    for opened in (*peers.values(), ours.session):
        opened.close()
    size = {"samples": samples, "horizon": horizon, "rounds": options.rounds, "threads": engine.n_threads}
    return [
        {"env": env, "planner": name, "version": version(name), **size}
        | figures(times.get(name, []), times[RAW], replays.get(name, []))
        | {**machine(), "note": notes.get(name, "")}
        for name in (RAW, OURS, *PEERS)
    ]


def version(planner: str) -> str:
    """Version of a peer; the others' are those of the columns ``mujoco`` and ``revision``."""
    try:
        return importlib.metadata.version(PEERS[planner].package) if planner in PEERS else ""
    except importlib.metadata.PackageNotFoundError:
        return ""


def figures(times: Clocks, raw: Clocks, replay: Clocks) -> dict[str, Any]:
    """Median milliseconds and speeds over raw and replay; empty where something did not run."""
    columns: dict[str, Any] = {}
    for i, clock in ((1, "cpu"), (0, "wall")):
        seconds, *bare = ([call[i] for call in calls] for calls in (times, raw, replay))
        columns[f"{clock}_ms"] = round(1e3 * float(np.median(seconds)), 4) if times else ""
        for name, other in zip(("raw", "replay"), bare, strict=True):
            columns[f"over_{name}_{clock}"] = round(sum(other) / sum(seconds), 4) if times and other else ""
    return columns


def print_table(rows: list[dict[str, Any]]) -> None:
    """One comparison."""
    names = ("cpu_ms", "wall_ms", "over_raw_cpu", "over_raw_wall", "over_replay_cpu", "over_replay_wall")
    print(f"{rows[0]['env']}, {rows[0]['samples']} x {rows[0]['horizon']} control steps")
    print(" " * 14 + "".join(f"{name:>18s}" for name in names))
    for row in rows:
        print(
            f"{row['planner']:14s}"
            + (f"    {row['note']}" if row["note"] else "".join(f"{row[name]:>18}" for name in names))
        )


def main() -> int:
    """Measure, print, put the rows in the place of older ones of the same sizes."""
    options = read_options(ThroughputOptions, "throughput")
    if options.scaling and len(set(options.samples or scaling.SAMPLES)) < 3:
        raise UserError("--scaling fits a line; give --samples at least 3 different sizes")
    torch.set_num_threads(1)
    for env in map(tasks.canonical_name, options.env):
        steps = PlanConfig.of("mppi", {"env": env}).usual.horizon
        if options.scaling:
            config = PlanConfig.of("mppi", {"env": env, "cost": options.cost, "search.finest": 1.0})
            sizes = options.samples or scaling.SAMPLES, options.horizon or (steps, 2 * steps)
            scaling.run(config, RunOptions(threads=options.threads), *sizes, options.rounds)
            continue
        for samples in options.samples or (64,):
            for horizon in options.horizon or (steps,):
                rows = compare(env, samples, horizon, options)
                print_table(rows)
                replace_results(RESULTS / "throughput.csv", COLUMNS, rows)
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
