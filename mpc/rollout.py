"""Batched rollouts of the true simulator: N control sequences x H control steps on all cores.

A rollout runs the task's own :class:`~napsp.envs.dynamics.Dynamics`, so it equals stepping
the environment bit for bit: same state (warm start and mocap included), same control
arithmetic, same observations.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from napsp.envs.dynamics import Dynamics

Actor = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Maps observations ``(1, O)`` and goals ``(1, G)`` to actions ``(1, A)``."""


@dataclass(frozen=True)
class Trajectories:
    """What N action sequences lead to.

    Attributes:
        observations: at control steps 1 .. H, ``(N, H, O)``.
        achieved_goals: at control steps 1 .. H, ``(N, H, G)``.
        diverged: simulations that blew up, bool ``(N,)``; their numbers mean nothing.
    """

    observations: np.ndarray
    achieved_goals: np.ndarray
    diverged: np.ndarray


def available_cores() -> int:
    """Cores this process may use (containers and taskset allow fewer than the machine has)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class RolloutEngine:
    """Rolls out action sequences from a full simulator state.

    Args:
        dynamics: the task's physics.
        n_threads: worker threads; default all cores. Results do not depend on it.
    """

    def __init__(self, dynamics: Dynamics, n_threads: int | None = None) -> None:
        self.dynamics = dynamics
        self.n_threads = n_threads or available_cores()
        # MjData takes megabytes: one per thread for good, never one per sample.
        self._datas = [mujoco.MjData(dynamics.model) for _ in range(self.n_threads)]
        self._simulations = [dynamics.bind(data) for data in self._datas]
        self._duration = dynamics.substeps * dynamics.model.opt.timestep
        self._pool: ThreadPoolExecutor | None = None
        self._native: Rollout | None = None

    def rollout(self, state: np.ndarray, actions: np.ndarray) -> Trajectories:
        """Simulate ``actions`` ``(N, H, A)`` from ``state`` of :func:`napsp.envs.dynamics.get_state`."""
        n_samples, horizon = actions.shape[:2]
        # A reset puts the clock to zero: starting later makes even a reset in the first step show.
        state = state.copy()
        state[0] += 1.0
        features = np.empty((n_samples, horizon, self.dynamics.n_features))
        final_times = np.empty(n_samples)
        controls = self.dynamics.control(actions)
        if horizon == 0:
            final_times[:] = state[0]  # d(s, a, g) alone: nothing to simulate
        elif self.dynamics.open_loop:
            self._run_native(state, controls, features, final_times)
        else:
            self._run_threads(state, controls, features, final_times)
        # A simulation that blew up was reset by MuJoCo to finite values at time zero, so its
        # clock is behind; looking for NaN alone would let it win.
        late_by = state[0] + horizon * self._duration - final_times
        diverged = (late_by > 0.5 * self.dynamics.model.opt.timestep) | ~np.isfinite(features).all((1, 2))
        observations, achieved_goals = self.dynamics.observe(features)
        return Trajectories(observations, achieved_goals, diverged)

    def follow(self, state: np.ndarray, observation: dict[str, np.ndarray], actor: Actor, horizon: int) -> np.ndarray:
        """Actions ``(H, A)`` of an actor that sees every simulated state, starting from ``state``."""
        simulation, features = self._simulations[0], np.empty((1, self.dynamics.n_features))
        simulation.restore(state)
        current, goal = observation["observation"], observation["desired_goal"].astype(np.float32)[None]
        actions = []
        for _ in range(horizon):
            actions.append(actor(current.astype(np.float32)[None], goal)[0])
            simulation.advance(self.dynamics.control(actions[-1])[None], features)
            current = self.dynamics.observe(features[0])[0]
        return np.stack(actions)

    def _run_threads(
        self, state: np.ndarray, controls: np.ndarray, features: np.ndarray, final_times: np.ndarray
    ) -> None:
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.n_threads)
        # Interleaved samples balance contact-rich and free ones without a queue.
        shares = [range(worker, len(controls), self.n_threads) for worker in range(self.n_threads)]
        jobs = [
            self._pool.submit(self._run_samples, worker, state, samples, controls, features, final_times)
            for worker, samples in enumerate(shares)
        ]
        for job in jobs:
            job.result()

    def _run_samples(
        self,
        worker: int,
        state: np.ndarray,
        samples: range,
        controls: np.ndarray,
        features: np.ndarray,
        final_times: np.ndarray,
    ) -> None:
        simulation, data = self._simulations[worker], self._datas[worker]
        for sample in samples:
            simulation.restore(state)
            simulation.advance(controls[sample], features[sample])
            final_times[sample] = data.time

    def _run_native(
        self, state: np.ndarray, controls: np.ndarray, features: np.ndarray, final_times: np.ndarray
    ) -> None:
        """One ``mujoco.rollout`` call for the whole batch; features are qpos and qvel."""
        if self._native is None:
            self._native = Rollout(nthread=self.n_threads)
        model, data = self.dynamics.model, self._datas[0]
        self._simulations[0].restore(state)
        start = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        held = np.repeat(controls, self.dynamics.substeps, axis=1)
        states, _ = self._native.rollout(model, self._datas, start, held, initial_warmstart=data.qacc_warmstart.copy())
        ends = np.asarray(states)[:, self.dynamics.substeps - 1 :: self.dynamics.substeps]
        features[:] = ends[..., 1 : 1 + model.nq + model.nv]
        final_times[:] = ends[:, -1, 0]

    def close(self) -> None:
        """Stop the worker threads."""
        if self._pool is not None:
            self._pool.shutdown()
        if self._native is not None:
            self._native.close()
        self._pool = self._native = None

    def __enter__(self) -> RolloutEngine:
        """Use as a context manager to stop the threads at the end."""
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
