"""Batched rollouts of the true simulator: N control sequences x H control steps on all cores.

A rollout runs the task's own :class:`~napsp.envs.dynamics.Dynamics`, so it equals stepping
the environment bit for bit: same state (clock, warm start and mocap included), same control
arithmetic, same observations.
"""

from __future__ import annotations

import multiprocessing
import os
import warnings
import weakref
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mpc.divergence import any_blew_up, blew_up, watch
from mpc.native import NativeRollout, hands_over
from mpc.threads import ThreadWorkers
from mpc.workers import CAN_FORK, ForkedWorkers, StuckError
from napsp.envs.dynamics import Dynamics
from napsp.envs.state import get_state, put_state
from napsp.envs.watch import Watched, WatchedDynamics

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
        diverged: whether the simulation has blown up by then, bool ``(H,)``.
    """

    actions: np.ndarray
    features: np.ndarray
    diverged: np.ndarray


def available_cores() -> int:
    """Cores this process may use (containers and taskset allow fewer than the machine has)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class RolloutEngine:
    """Rolls out action sequences from a full simulator state.

    What a task changes in the numbers of its model is seen by the next rollout, and so are another model and attributes
    of its dynamics that are set anew; what it changes elsewhere is, where processes simulate, after :meth:`reset`.

    Args:
        dynamics: the task's physics. Helper processes hold a copy of it as it was at the last :meth:`reset`.
        n_threads: simulations that run at once; default all cores. Results do not depend on it.
        fork: let forked processes run them, which is a little faster than threads; default
            where the operating system allows it. A simulation that gets stuck there, because it uses a library with
            threads of its own, goes on in threads of this process.
        source: answers which dynamics to plan in now, for tasks that make new ones; default always ``dynamics``.

    Attributes:
        path: how the last rollout was simulated, in words.
    """

    path = "nothing simulated yet"

    def __init__(
        self,
        dynamics: Dynamics,
        n_threads: int | None = None,
        fork: bool = CAN_FORK,
        source: Callable[[], Dynamics] | None = None,
    ) -> None:
        self.dynamics, self._source = dynamics, source
        self.n_threads = n_threads or available_cores()
        self._fork = fork
        self._threads: ThreadWorkers | None = None
        self._helpers: ForkedWorkers | None = None
        self._helper_seconds = 0.0
        self._native: NativeRollout | None = None
        self._bind()
        _ENGINES.add(self)

    def _bind(self) -> None:
        self._model = self.dynamics.model
        # MjData takes megabytes: one per worker for good, never one per sample.
        self._datas = [mujoco.MjData(self._model) for _ in range(self.n_threads)]
        self._simulations = [self.dynamics.bind(data) for data in self._datas]

    @property
    def helper_seconds(self) -> float:
        """CPU time spent in helper processes so far."""
        return self._helper_seconds + (self._helpers.cpu_seconds if self._helpers else 0.0)

    @property
    def forks(self) -> bool:
        """Whether helper processes may simulate: not in daemons, which may have none, and not once they got stuck."""
        return self._fork and not multiprocessing.current_process().daemon

    def reset(self) -> None:
        """Let helper processes see what has changed in the dynamics, as a new episode may bring."""
        self._end_helpers()

    def use(self, dynamics: Dynamics) -> None:
        """Plan in other dynamics from now on."""
        self.dynamics = dynamics
        self._end_helpers()
        self._bind()

    def leave_to_parent(self) -> None:
        """In a fork of this process: forget helpers and threads, which are the parent's and do not run here."""
        _OF_PARENT.extend((self._threads, self._native, self._helpers))  # to end them would wait for what is not here
        self._threads = self._native = self._helpers = None

    def update(self) -> None:
        """Take over what the task has changed: other dynamics, another model or numbers in it. Rollouts begin so."""
        dynamics = self._source() if self._source else self.dynamics
        if dynamics is not self.dynamics or dynamics.model is not self._model:
            self.use(dynamics)
        elif self._helpers is not None and any(watched.changed() for watched in self._watched):
            self._end_helpers()  # they hold a copy

    def rollout(self, state: np.ndarray, actions: np.ndarray, known: Sequence[Followed] = ()) -> Trajectories:
        """Simulate ``actions`` ``(N, H, A)`` from ``state`` of :func:`napsp.envs.state.get_state`.

        Samples equal to actions in ``known``, followed from the same state, are copied from
        there instead.
        """
        self.update()
        n_samples, horizon = actions.shape[:2]
        features = np.empty((n_samples, horizon, self.dynamics.n_features))
        diverged, is_known = np.zeros(n_samples), np.zeros(n_samples, bool)
        for own in known if horizon else ():
            same = (actions == own.actions[:horizon]).all((1, 2))
            features[same], diverged[same] = own.features[:horizon], own.diverged[horizon - 1]
            is_known |= same
        samples = np.flatnonzero(~is_known)
        if horizon and len(samples):  # without a horizon d(s, a, g) alone counts; mujoco.rollout crashes on no samples
            controls = self.dynamics.control(actions)
            if self.dynamics.open_loop:
                samples = self._run_native(state, controls, samples, features)
            if len(samples):
                self._run_workers(state, controls, samples, features, diverged)
        return Trajectories(*self.dynamics.observe(features), any_blew_up(diverged, features))

    def follow(self, state: np.ndarray, observation: dict[str, np.ndarray], actor: Actor, horizon: int) -> Followed:
        """Let an actor that sees every simulated state act for ``horizon`` steps from ``state``."""
        self.update()
        simulation, data = self._simulations[0], self._datas[0]
        features, diverged = np.empty((horizon, self.dynamics.n_features)), np.empty(horizon, bool)
        self._begin(0, state)
        current, goal = observation["observation"], observation["desired_goal"].astype(np.float32)[None]
        actions = []
        for step in range(horizon):
            actions.append(actor(current.astype(np.float32)[None], goal)[0])
            simulation.advance(self.dynamics.control(actions[-1])[None], features[step : step + 1])
            diverged[step] = blew_up(data)
            current = self.dynamics.observe(features[step])[0]
        return Followed(np.stack(actions), features, diverged)

    def trace(self, state: np.ndarray, actions: np.ndarray) -> tuple[Trajectories, np.ndarray]:
        """Roll out one plan ``(H, A)``; also the full states ``(H, S)`` before each step, fit for :meth:`rollout`."""
        self.update()
        simulation, data, dynamics = self._simulations[0], self._datas[0], self.dynamics
        features, states = np.empty((1, len(actions), dynamics.n_features)), np.empty((len(actions), len(state)))
        controls = dynamics.control(actions)
        self._begin(0, state)
        for step in range(len(actions)):
            states[step] = get_state(self._model, data)
            simulation.advance(controls[step : step + 1], features[0, step : step + 1])
        diverged = any_blew_up(np.array([blew_up(data)]), features)
        return Trajectories(*dynamics.observe(features), diverged), states

    def _begin(self, worker: int, state: np.ndarray) -> None:
        put_state(self._simulations[worker], self._model, self._datas[worker], state)
        watch(self._datas[worker])

    def _run_workers(
        self,
        state: np.ndarray,
        controls: np.ndarray,
        samples: np.ndarray,
        features: np.ndarray,
        diverged: np.ndarray,
    ) -> None:
        if self.n_threads == 1 or len(samples) < 2:
            self.path = "one thread"
            self._run_samples(0, state, samples, controls, features, diverged)
        elif not self.forks:
            self.path = f"{self.n_threads} threads"
            self._threads = self._threads or ThreadWorkers(self._run_samples, self.n_threads)
            self._threads.run(state, samples, controls, features, diverged)
        else:
            self.path = f"{self.n_threads} processes"
            try:
                self._forked(controls, features).run(state, samples, controls, features, diverged)
            except StuckError as stuck:
                self._end_helpers()
                self._fork = False
                warnings.warn(f"{stuck}; simulating in threads, as fork=False does at once", RuntimeWarning, 3)
                self._run_workers(state, controls, samples, features, diverged)
            except BaseException:  # Ctrl-C too: answers still under way would pass for the next call's
                self._end_helpers()
                raise

    def _forked(self, controls: np.ndarray, features: np.ndarray) -> ForkedWorkers:
        if self._helpers is None or not self._helpers.fit(controls) or not self._helpers.alive():
            self._end_helpers()
            sizes = controls.shape[0] * controls.shape[1], controls.shape[2], features.shape[2]
            self._watched = Watched(self._model), WatchedDynamics(self.dynamics)
            self._helpers = ForkedWorkers(self._run_samples, self.n_threads - 1, *sizes)
        return self._helpers

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
        diverged: np.ndarray,
    ) -> None:
        simulation, data = self._simulations[worker], self._datas[worker]
        for sample in samples:
            self._begin(worker, state)
            simulation.advance(controls[sample], features[sample])
            diverged[sample] = blew_up(data)

    def _run_native(
        self, state: np.ndarray, controls: np.ndarray, samples: np.ndarray, features: np.ndarray
    ) -> np.ndarray:
        """Fill in features of what one ``mujoco.rollout`` call can simulate; the samples that it can not."""
        put_state(self._simulations[0], self._model, self._datas[0], state)
        substeps = self.dynamics.substeps
        if not hands_over(self._model, self._datas[0], controls.shape[1] * substeps):
            return samples
        self.path = f"mujoco.rollout, {self.n_threads} threads"
        if self._native is None:
            self._native = NativeRollout(self.n_threads)
        found = features if len(samples) == len(features) else features[samples]
        warned = self._native.run(self._model, self._datas, controls[samples], substeps, found)
        features[samples] = found
        return samples[warned]

    def close(self) -> None:
        """Stop the workers."""
        self._end_helpers()
        for pool in (self._threads, self._native):
            if pool is not None:
                pool.close()
        self._threads = self._native = None

    def __enter__(self) -> RolloutEngine:
        """Use as a context manager to stop the workers at the end."""
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


_ENGINES: weakref.WeakSet[RolloutEngine] = weakref.WeakSet()
_OF_PARENT: list[object] = []


def _leave_all_to_parent() -> None:
    for engine in _ENGINES:
        engine.leave_to_parent()


if CAN_FORK:
    os.register_at_fork(after_in_child=_leave_all_to_parent)
