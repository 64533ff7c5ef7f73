"""How fast a whole plan call is: against replay, against raw ``mujoco.rollout``, and data collection.

``python -m benchmarks.rollout_speed --env fetch_wall`` interleaves four things in one run, on one
model, with the same samples and horizon, at every state of a planned episode. Throughput is work
over time, so the ratios are those of total times; medians of the per-state ratios stand beside them
(they differ where raw rollouts meet other contacts than plans do):

* plan: a whole plan call (sampling with noise of one size in every task, rollouts, cost with the learned d, update);
* replay: the very same motions handed to one ``mujoco.rollout`` call: the same physics without
  any of this package;
* raw: ``mujoco.rollout`` with constant controls;
* collection, with Fetch tasks: fetch_reach's own step against gymnasium-robotics' stock step on the same model
  (the step's code is the same in all of them).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import gymnasium
import mujoco
import numpy as np
from mujoco.rollout import Rollout

from benchmarks.cells import report
from benchmarks.command import read_options
from benchmarks.raw_rollout import HELD, RawRollout
from mpc.controller import Plan
from mpc.rollout import RolloutEngine, available_cores
from napsp import envs as tasks
from napsp.envs.coarse import coarse
from napsp.envs.dynamics import Dynamics, get_state
from napsp.envs.fetch import FetchReachEnv
from napsp.errors import run_command
from napsp.storage.revision import git_revision
from planners.app.config import PlanConfig
from planners.app.options import RunOptions
from planners.app.session import Session

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
FINGERS = ("robot0:r_gripper_finger_joint", "robot0:l_gripper_finger_joint")  # set back after each step


@dataclass(frozen=True)
class SpeedOptions:
    """Measure plan throughput and data collection."""

    env: str = "fetch_wall"
    """Task."""
    checkpoint: Path | None = None
    """A file or folder written by napsp.train; default: the one that ships for the task."""
    samples: int = 64
    """Plans per call."""
    horizon: int = 15
    """Control steps per plan."""
    proposals: bool = True
    """Let the policy's own rollout join the samples, as planning does by default."""
    planning_model: Literal["exact", "coarse"] = "exact"
    """The model planned in; replay and raw run the environment's, or its coarse copy, too."""
    rounds: int = 15
    """Interleaved rounds, one per control step of the episode."""
    threads: int | None = None
    """Simulation threads; default all cores."""
    out: Path | None = None
    """JSON file for the figures."""


class Replay:
    """One ``mujoco.rollout`` call that repeats the very motions of given action sequences.

    A control step is one entry of the batch: it starts from the state, warm start, forces and
    mocap pose that the simulator had at its beginning. So the physics are the same to the bit
    (checked), although Fetch moves the fingers between control steps, and nothing but MuJoCo
    runs.
    """

    def __init__(self, dynamics: Dynamics, state: np.ndarray, actions: np.ndarray, n_threads: int) -> None:
        model, data = dynamics.model, mujoco.MjData(dynamics.model)
        simulation = dynamics.bind(data)
        n = actions.shape[0] * actions.shape[1]
        self._starts = np.empty((n, mujoco.mj_stateSize(model, FULL)))
        self._warmstarts = np.empty((n, model.nv))
        self._controls = np.empty((n, 1, mujoco.mj_stateSize(model, HELD)))
        ends, scratch = np.empty((n, model.nq)), np.empty((1, dynamics.n_features))
        step = 0
        for sequence in dynamics.control(actions):
            simulation.restore(state)
            for control in sequence:
                mujoco.mj_getState(model, data, self._starts[step], FULL)
                self._warmstarts[step] = data.qacc_warmstart
                simulation.advance(control[None], scratch)
                mujoco.mj_getState(model, data, self._controls[step, 0], HELD)
                ends[step] = data.qpos
                step += 1
        self._model, self._datas = model, [mujoco.MjData(model) for _ in range(n_threads)]
        self._n_steps, self._rollout = dynamics.substeps, Rollout(nthread=n_threads)
        free = [i for i in range(model.nq) if model.joint(i).name not in FINGERS]
        if not np.array_equal(self()[:, free], ends[:, free]):
            raise RuntimeError("the replayed motions differ from the planned ones; the comparison would mean nothing")

    def __call__(self) -> np.ndarray:
        """Simulate; final joint positions ``(samples * steps, nq)``."""
        states, _ = self._rollout.rollout(
            self._model,
            self._datas,
            self._starts,
            self._controls,
            control_spec=HELD,
            nstep=self._n_steps,
            initial_warmstart=self._warmstarts,
        )
        return np.asarray(states)[:, -1, 1 : 1 + self._model.nq]

    def close(self) -> None:
        """Stop the worker threads."""
        self._rollout.close()


def clocked(job: Callable[[], object], engine: RolloutEngine) -> tuple[float, float]:
    """Wall and CPU seconds of one call, those of the engine's helper processes included."""
    wall, cpu = time.perf_counter(), time.process_time() + engine.helper_seconds
    job()
    return time.perf_counter() - wall, time.process_time() + engine.helper_seconds - cpu


def measure_plan(options: SpeedOptions) -> dict[str, Any]:
    """Ratios of plan, replay and raw."""
    changes = {"env": options.env, "horizon": options.horizon, "proposals": options.proposals}
    changes |= {"search.samples": options.samples, "model.kind": options.planning_model, "search.finest": 1.0}
    run = RunOptions(checkpoint=options.checkpoint, threads=options.threads)
    session = Session.open(PlanConfig.of("mppi", changes), run)
    world, controller = session.env.unwrapped, session.controller
    dynamics = world.dynamics  # decoration included, which plans leave out
    if options.planning_model == "coarse":
        dynamics = coarse(dynamics, controller.engine.dynamics.substeps)
    n_threads = controller.engine.n_threads
    table: dict[str, list[tuple[float, float]]] = {"plan": [], "replay": [], "raw": []}
    observation, _ = session.env.reset(seed=0)
    simulate = controller.engine.rollout
    controller.plan(world, observation)  # first call: allocation
    for _ in range(options.rounds):
        state = get_state(world.model, world.data)
        raw = RawRollout(dynamics, n_threads, state, options.samples, options.horizon)
        raw()  # first call: allocation
        table["raw"].append(clocked(raw, controller.engine))
        tried: list[np.ndarray] = []
        controller.engine.rollout = lambda s, a, known=(): (tried.append(a), simulate(s, a, known))[1]  # noqa: B023
        plans: list[Plan] = []
        table["plan"].append(clocked(lambda: plans.append(controller.plan_from(state, observation)), controller.engine))  # noqa: B023
        replay = Replay(dynamics, state, tried[0], n_threads)
        table["replay"].append(clocked(replay, controller.engine))
        replay.close()
        raw.close()
        observation, *_ = session.env.step(plans[0].action)
    times = {name: np.array(rows) for name, rows in table.items()}
    session.close()
    figures: dict[str, Any] = {}
    for peer in ("replay", "raw"):
        for i, clock in enumerate(("wall", "cpu")):
            plan, bare = times["plan"][:, i], times[peer][:, i]
            figures[f"plan_over_{peer}_{clock}"] = float(bare.sum() / plan.sum())
            figures[f"plan_over_{peer}_{clock}_median"] = float(np.median(bare / plan))
    return {
        **figures,
        "plan_ms": 1e3 * float(np.median(times["plan"][:, 0])),
        "control_steps_per_second": options.samples * options.horizon / float(times["plan"][:, 0].mean()),
    }


def measure_collection(rounds: int) -> dict[str, float]:
    """CPU time per step of fetch_reach: stock step, ours on the same model, ours with the filtered arm."""
    from gymnasium_robotics.envs.fetch.fetch_env import MujocoFetchEnv

    from napsp.envs.joint_types import mend_joint_types

    mend_joint_types()

    class StockStep(FetchReachEnv):
        """The same model stepped by gymnasium-robotics' own code."""

        step = MujocoFetchEnv.step
        _get_obs = MujocoFetchEnv._get_obs

    envs = {
        "stock": StockStep(arm_self_collision=True),
        "ours_same_model": FetchReachEnv(arm_self_collision=True),
        "ours": FetchReachEnv(),
    }
    actions = np.random.default_rng(0).uniform(-1, 1, (50, 4)).astype(np.float32)
    times: dict[str, list[float]] = {name: [] for name in envs}
    for round_ in range(rounds):
        for name, env in envs.items():
            env.reset(seed=round_)
            start = time.process_time()
            for action in actions:
                env.step(action)
            times[name].append(time.process_time() - start)
    stock = np.array(times["stock"])
    return {
        "collection_speedup_same_model": float(np.median(stock / times["ours_same_model"])),
        "collection_speedup": float(np.median(stock / times["ours"])),
    }


def main() -> int:
    """Measure, print, optionally write JSON."""
    options = read_options(SpeedOptions, "rollout_speed")
    figures: dict[str, Any] = {
        "env": tasks.canonical_name(options.env),
        "samples": options.samples,
        "horizon": options.horizon,
        "proposals": options.proposals,
        "planning_model": options.planning_model,
        "threads": options.threads or available_cores(),
        "mujoco": mujoco.__version__,
        "gymnasium": gymnasium.__version__,
        "revision": git_revision(),
        **measure_plan(options),
    }
    if figures["env"].startswith("fetch"):
        figures |= measure_collection(options.rounds)
    report(figures, options.out)
    return 0


if __name__ == "__main__":
    run_command(main)
    sys.exit(0)
