"""Batched rollouts of the true simulator: N control sequences x H control steps on all cores.

A rollout runs the task's own :class:`~napsp.envs.dynamics.Dynamics`, so it equals stepping
the environment bit for bit: same state (warm start and mocap included), same control
arithmetic, same observations.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from mpc.workers import CAN_FORK, ForkedWorkers
from napsp.envs.dynamics import Dynamics, get_state

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


@dataclass(frozen=True)
class Followed:
    """What an actor did and saw on its own rollout.

    Attributes:
        actions: ``(H, A)``.
        features: of the dynamics at control steps 1 .. H, ``(H, F)``.
        times: the simulation's clock at the same steps, ``(H,)``.
    """

    actions: np.ndarray
    features: np.ndarray
    times: np.ndarray


def available_cores() -> int:
    """Cores this process may use (containers and taskset allow fewer than the machine has)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class RolloutEngine:
    """Rolls out action sequences from a full simulator state.

    Args:
        dynamics: the task's physics. Helper processes hold a copy of it as it was at the last
            :meth:`reset`.
        n_threads: simulations that run at once; default all cores. Results do not depend on it.
        fork: let forked processes run them, which is a little faster than threads; default
            where the operating system allows it.
    """

    def __init__(self, dynamics: Dynamics, n_threads: int | None = None, fork: bool = CAN_FORK) -> None:
        self.dynamics = dynamics
        self.n_threads = n_threads or available_cores()
        self._fork = fork and not multiprocessing.current_process().daemon  # daemons may not have children
        # MjData takes megabytes: one per worker for good, never one per sample.
        self._datas = [mujoco.MjData(dynamics.model) for _ in range(self.n_threads)]
        self._simulations = [dynamics.bind(data) for data in self._datas]
        self._duration = dynamics.substeps * dynamics.model.opt.timestep
        self._pool: ThreadPoolExecutor | None = None
        self._helpers: ForkedWorkers | None = None
        self._helper_seconds = 0.0
        self._native: Rollout | None = None

    @property
    def helper_seconds(self) -> float:
        """CPU time spent in helper processes so far."""
        return self._helper_seconds + (self._helpers.cpu_seconds if self._helpers else 0.0)

    def reset(self) -> None:
        """Let helper processes see what has changed in the dynamics, as a new episode may bring."""
        self._end_helpers()

    def rollout(self, state: np.ndarray, actions: np.ndarray, known: Sequence[Followed] = ()) -> Trajectories:
        """Simulate ``actions`` ``(N, H, A)`` from ``state`` of :func:`napsp.envs.dynamics.get_state`.

        Samples equal to actions in ``known``, followed from the same state, are copied from
        there instead.
        """
        n_samples, horizon = actions.shape[:2]
        state = _later(state)
        features = np.empty((n_samples, horizon, self.dynamics.n_features))
        final_times = np.full(n_samples, state[0])
        is_known = np.zeros(n_samples, bool)
        for own in known if horizon else ():
            same = (actions == own.actions[:horizon]).all((1, 2))
            features[same], final_times[same] = own.features[:horizon], own.times[horizon - 1]
            is_known |= same
        samples = np.flatnonzero(~is_known)
        if horizon and len(samples):  # without a horizon d(s, a, g) alone counts; mujoco.rollout crashes on no samples
            run = self._run_native if self.dynamics.open_loop else self._run_workers
            run(state, self.dynamics.control(actions), samples, features, final_times)
        diverged = self._diverged(state, features, final_times)
        return Trajectories(*self.dynamics.observe(features), diverged)

    def follow(self, state: np.ndarray, observation: dict[str, np.ndarray], actor: Actor, horizon: int) -> Followed:
        """Let an actor that sees every simulated state act for ``horizon`` steps from ``state``."""
        simulation, data = self._simulations[0], self._datas[0]
        features, times = np.empty((horizon, self.dynamics.n_features)), np.empty(horizon)
        simulation.restore(_later(state))
        current, goal = observation["observation"], observation["desired_goal"].astype(np.float32)[None]
        actions = []
        for step in range(horizon):
            actions.append(actor(current.astype(np.float32)[None], goal)[0])
            simulation.advance(self.dynamics.control(actions[-1])[None], features[step : step + 1])
            times[step] = data.time
            current = self.dynamics.observe(features[step])[0]
        return Followed(np.stack(actions), features, times)

    def trace(self, state: np.ndarray, actions: np.ndarray) -> tuple[Trajectories, np.ndarray]:
        """Roll out one plan ``(H, A)``; also the full states ``(H, S)`` before each step, fit for :meth:`rollout`."""
        simulation, data, dynamics = self._simulations[0], self._datas[0], self.dynamics
        features, states = np.empty((1, len(actions), dynamics.n_features)), np.empty((len(actions), len(state)))
        controls = dynamics.control(actions)
        simulation.restore(_later(state))
        for step in range(len(actions)):
            states[step] = get_state(dynamics.model, data)
            states[step, 0] -= 1.0  # the environment's clock again
            simulation.advance(controls[step : step + 1], features[0, step : step + 1])
        diverged = self._diverged(_later(state), features, np.array([data.time]))
        return Trajectories(*dynamics.observe(features), diverged), states

    def _diverged(self, start: np.ndarray, features: np.ndarray, final_times: np.ndarray) -> np.ndarray:
        # A simulation that blew up was reset by MuJoCo to finite values at time zero, so its
        # clock is behind; looking for NaN alone would let it win.
        late_by = start[0] + features.shape[1] * self._duration - final_times
        return (late_by > 0.5 * self.dynamics.model.opt.timestep) | ~np.isfinite(features).all((1, 2))

    def _run_workers(
        self,
        state: np.ndarray,
        controls: np.ndarray,
        samples: np.ndarray,
        features: np.ndarray,
        final_times: np.ndarray,
    ) -> None:
        if self.n_threads == 1 or len(samples) < 2:
            self._run_samples(0, state, samples, controls, features, final_times)
        elif self._fork:
            if self._helpers is None or not self._helpers.fit(controls):
                self._end_helpers()
                sizes = controls.shape[0] * controls.shape[1], controls.shape[2], features.shape[2]
                self._helpers = ForkedWorkers(self._run_samples, self.n_threads - 1, *sizes)
            try:
                self._helpers.run(state, samples, controls, features, final_times)
            except BaseException:  # Ctrl-C too: answers still under way would pass for the next call's
                self._end_helpers()
                raise
        else:
            self._run_threads(state, controls, samples, features, final_times)

    def _run_threads(
        self,
        state: np.ndarray,
        controls: np.ndarray,
        samples: np.ndarray,
        features: np.ndarray,
        final_times: np.ndarray,
    ) -> None:
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.n_threads)
        taken = iter(samples.tolist())  # its next() is atomic
        jobs = [
            self._pool.submit(self._run_samples, worker, state, taken, controls, features, final_times)
            for worker in range(self.n_threads)
        ]
        for job in jobs:
            job.result()

    def _end_helpers(self) -> None:
        if self._helpers is not None:
            self._helper_seconds += self._helpers.cpu_seconds
            self._helpers.close()
        self._helpers = None

    def _run_samples(
        self,
        worker: int,
        state: np.ndarray,
        samples: Iterable[int],
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
        self,
        state: np.ndarray,
        controls: np.ndarray,
        samples: np.ndarray,
        features: np.ndarray,
        final_times: np.ndarray,
    ) -> None:
        """One ``mujoco.rollout`` call for the whole batch; features are qpos and qvel."""
        if self._native is None:
            self._native = Rollout(nthread=self.n_threads)
        model, data = self.dynamics.model, self._datas[0]
        self._simulations[0].restore(state)
        start = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        held = np.repeat(controls[samples], self.dynamics.substeps, axis=1)
        states, _ = self._native.rollout(model, self._datas, start, held, initial_warmstart=data.qacc_warmstart.copy())
        ends = np.asarray(states)[:, self.dynamics.substeps - 1 :: self.dynamics.substeps]
        features[samples] = ends[..., 1 : 1 + model.nq + model.nv]
        final_times[samples] = ends[:, -1, 0]

    def close(self) -> None:
        """Stop the workers."""
        self._end_helpers()
        if self._pool is not None:
            self._pool.shutdown()
        if self._native is not None:
            self._native.close()
        self._pool = self._native = None

    def __enter__(self) -> RolloutEngine:
        """Use as a context manager to stop the workers at the end."""
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def _later(state: np.ndarray) -> np.ndarray:
    """Start with a positive clock: MuJoCo's reset puts it to zero, so even one in the first step shows."""
    state = state.copy()
    state[0] += 1.0
    return state
