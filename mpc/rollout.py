"""Batched rollouts of the true simulator: N control sequences x H control steps on all cores.

A rollout runs the task's own :class:`~napsp.envs.dynamics.Dynamics`, so it equals stepping
the environment bit for bit: same state (clock, warm start and mocap included), same control
arithmetic, same observations. What a worker simulates with is a simulator of :mod:`mpc.simulators`.
"""

from __future__ import annotations

import multiprocessing
import os
import warnings
import weakref
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mpc.divergence import any_blew_up
from mpc.native import NativeRollout, hands_over
from mpc.simulators import State, simulators, state_of
from mpc.threads import ThreadWorkers
from mpc.workers import CAN_FORK, ForkedWorkers, StuckError
from napsp.envs.dynamics import Dynamics
from napsp.envs.watch import watched

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
        simulators: one per worker.
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
        self.simulators = simulators(self.dynamics, self.n_threads)

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
        elif self._helpers is not None and any(part.changed() for part in self._watched):
            self._end_helpers()  # they hold a copy

    def state_of(self, world: Any) -> State:
        """The state of an environment (unwrapped), which is only read, fit for :meth:`rollout`.

        Raises:
            ValueError: the model planned in has another state.
        """
        self.update()
        return state_of(self.dynamics, world)

    def rollout(self, state: State, actions: np.ndarray, known: Sequence[Followed] = ()) -> Trajectories:
        """Simulate ``actions`` ``(N, H, A)`` from ``state`` of :meth:`state_of`.

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

    def follow(self, state: State, observation: dict[str, np.ndarray], actor: Actor, horizon: int) -> Followed:
        """Let an actor that sees every simulated state act for ``horizon`` steps from ``state``."""
        self.update()
        simulator = self.simulators[0]
        features, diverged = np.empty((horizon, self.dynamics.n_features)), np.empty(horizon, bool)
        simulator.begin(state)
        current, goal = observation["observation"], observation["desired_goal"].astype(np.float32)[None]
        actions = []
        for step in range(horizon):
            actions.append(actor(current.astype(np.float32)[None], goal)[0])
            simulator.advance(self.dynamics.control(actions[-1])[None], features[step : step + 1])
            diverged[step] = simulator.blew_up()
            current = self.dynamics.observe(features[step])[0]
        return Followed(np.stack(actions), features, diverged)

    def trace(self, state: State, actions: np.ndarray) -> tuple[Trajectories, list[State]]:
        """Roll out one plan ``(H, A)``; also the full states before each step, fit for :meth:`rollout`."""
        self.update()
        simulator, dynamics, states = self.simulators[0], self.dynamics, []
        features, controls = np.empty((1, len(actions), dynamics.n_features)), dynamics.control(actions)
        simulator.begin(state)
        for step in range(len(actions)):
            states.append(simulator.state())
            simulator.advance(controls[step : step + 1], features[0, step : step + 1])
        diverged = any_blew_up(np.array([simulator.blew_up()]), features)
        return Trajectories(*dynamics.observe(features), diverged), states

    def _run_workers(
        self,
        state: State,
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
            self._watched = watched(self.dynamics)
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
        state: State,
        samples: Iterable[int],
        controls: np.ndarray,
        features: np.ndarray,
        diverged: np.ndarray,
    ) -> None:
        simulator = self.simulators[worker]
        for sample in samples:
            simulator.begin(state)
            simulator.advance(controls[sample], features[sample])
            diverged[sample] = simulator.blew_up()

    def _run_native(self, state: State, controls: np.ndarray, samples: np.ndarray, features: np.ndarray) -> np.ndarray:
        """Fill in features of what one ``mujoco.rollout`` call can simulate; the samples that it can not."""
        self.simulators[0].load(state)
        substeps, datas = self.dynamics.substeps, [simulator.data for simulator in self.simulators]
        if not hands_over(self._model, datas[0], controls.shape[1] * substeps):
            return samples
        self.path = f"mujoco.rollout, {self.n_threads} threads"
        if self._native is None:
            self._native = NativeRollout(self.n_threads)
        found = features if len(samples) == len(features) else features[samples]
        warned = self._native.run(self._model, datas, controls[samples], substeps, found)
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
