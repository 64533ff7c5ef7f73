"""Planning beside a simulation that does not wait: a thread that plans from the newest state handed in."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

import numpy as np

from mpc.controller import Controller, Plan


@dataclass(frozen=True)
class Job:
    """A state to plan from: the control step it is before, the full state, its observation, and when that was.

    ``executed`` ``(k, A)``, k <= 2, are the actions before it, the latest last.
    """

    number: int
    state: np.ndarray
    observation: dict[str, np.ndarray]
    executed: np.ndarray
    at: float


@dataclass(frozen=True)
class Planned:
    """A plan, what it costs alone, in steps, and what it was made for."""

    job: Job
    plan: Plan
    cost: float

    def action(self, number: int) -> np.ndarray:
        """The action ``(A,)`` for a control step; zero, which holds still, once the plan has run out."""
        age, actions = number - self.job.number, self.plan.actions
        return actions[age] if age < len(actions) else np.zeros_like(actions[0])


class NewestPlan:
    """Plans in a thread until it is closed; a state that a newer one overtakes is not planned from.

    Args:
        controller: nobody else may use it meanwhile.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._changed = threading.Condition()
        self._job: Job | None = None
        self._planned: Planned | None = None
        self._error: BaseException | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._work, name="planning", daemon=True)
        self._thread.start()

    def offer(self, number: int, state: np.ndarray, observation: dict[str, np.ndarray], executed: np.ndarray) -> None:
        """Hand in a :class:`Job`, of arrays that are not written to any more."""
        with self._changed:
            self._job = Job(number, state, observation, executed, time.monotonic())
            self._changed.notify_all()

    @property
    def newest(self) -> Planned | None:
        """The newest plan; None before the first.

        Raises:
            Exception: what planning failed with.
        """
        with self._changed:
            if self._error is not None:
                raise self._error
            return self._planned

    @property
    def number(self) -> int | None:
        """The control step that was planned for last; None before the first plan."""
        return None if self._planned is None else self._planned.job.number

    def close(self) -> None:
        """Stop, when the plan under way is made."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()

    def _work(self) -> None:
        before: Job | None = None
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closing or self._job is not None)
                job, self._job = self._job, None
                if self._closing or job is None:
                    return
            try:
                planned = self._plan(job, before)
            except Exception as error:  # told to who asks for the plan
                with self._changed:
                    self._error = error
                return
            with self._changed:
                self._planned = planned
            before = job

    def _plan(self, job: Job, before: Job | None) -> Planned:
        if before is not None:  # every plan call moves the last plan on by one step; the world has moved on by more
            self._controller.skip(job.number - before.number - 1)
        plan = self._controller.plan_from(job.state, job.observation, job.executed)
        return Planned(job, plan, self._controller.cost_from(job.state, job.observation, plan.actions))
