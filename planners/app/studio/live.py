"""The studio without a browser: a simulation with its planner in a thread, and the orders it takes."""

from __future__ import annotations

import queue
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import numpy as np

from napsp.envs.state import get_state
from napsp.errors import UserError
from planners.app.studio.choices import Choices
from planners.app.studio.newest import NewestPlan
from planners.app.studio.opening import open_session, period_of
from planners.app.studio.trial import Scenery, Trial

PATIENCE = 0.5  # seconds that a paused simulation looks for orders before it looks whether it should end


class Live:
    """Simulates and plans in a thread of its own, which alone touches the session; others give it orders.

    An order returns at once, with a future that is done when the order is. The future of an impossible one raises its
    UserError, which :attr:`problem` holds as well. What is to be seen is :attr:`scenery`, replaced as a whole after
    every step.

    Args:
        choices: what to plan.
        realtime: execute the newest plan at every control period, however old, instead of waiting for a new one.

    Attributes:
        choices: what is planned now.
        scenery: the newest picture.
        running: whether the simulation goes on by itself.
        realtime: see above; read at every control step.
        goes_on: when an episode has had its length, begin that of the next seed; else go on with it.
        problem: why the last order was refused, or what stopped the simulation; empty if nothing did.

    Raises:
        UserError: what is chosen is impossible.
    """

    def __init__(self, choices: Choices, realtime: bool = False) -> None:
        self.choices, self.realtime, self.goes_on = choices, realtime, False
        self.running, self.problem = False, ""
        self._orders: queue.SimpleQueue[tuple[Callable[[], None], Future[None]]] = queue.SimpleQueue()
        self._asked: dict[str, Any] = {}
        self._goal: np.ndarray | None = None
        self._lock = threading.Lock()  # of what was asked for
        self._newest: NewestPlan | None = None
        self._due = 0.0
        self._closing = False
        self._session = open_session(choices)
        self._trial = Trial(self._session, choices.run.seed)
        self.scenery: Scenery = self._trial.scenery()
        self._thread = threading.Thread(target=self._work, name="simulation", daemon=True)
        self._thread.start()

    def run(self) -> Future[None]:
        """Go on, until told otherwise."""
        return self._order(lambda: self._run(True))

    def pause(self) -> Future[None]:
        """Stop before the next control step."""
        return self._order(lambda: self._run(False))

    def step(self) -> Future[None]:
        """Pause, and make one control step."""
        return self._order(self._one_step)

    def reset(self) -> Future[None]:
        """Begin the episode anew, with the goal of its seed."""
        return self._order(lambda: self._begin(self.choices.run.seed))

    def change(self, name: str, value: Any) -> Future[None]:
        """Choose another value and begin anew with it; of several that come while a step is made the last counts.

        Args:
            name: see :meth:`planners.app.studio.choices.Choices.changed`.
            value: the value.
        """
        with self._lock:
            self._asked[name] = value
        return self._order(self._change)

    def move_goal(self, goal: np.ndarray) -> Future[None]:
        """Put the goal ``(G,)`` elsewhere, in the episode that goes on; of several the last counts."""
        with self._lock:
            self._goal = np.array(goal, float)
        return self._order(self._move_goal)

    def close(self) -> None:
        """End threads and processes; a second call does nothing."""
        self._closing = True
        self._order(lambda: None)  # wakes it
        self._thread.join()
        self._session.close()

    def _order(self, do: Callable[[], None]) -> Future[None]:
        done: Future[None] = Future()
        self._orders.put((do, done))
        return done

    def _work(self) -> None:
        while not self._closing:
            self._take_orders()
            if self.running and not self._closing:
                self._try(self._go_on)
        self._stop_planning()

    def _take_orders(self) -> None:
        wait = max(0.0, self._due - time.monotonic()) if self.running else PATIENCE
        while True:
            try:
                do, done = self._orders.get(timeout=wait) if wait else self._orders.get_nowait()
            except queue.Empty:
                return
            error = self._try(do)
            done.set_exception(error) if error else done.set_result(None)
            wait = max(0.0, self._due - time.monotonic()) if self.running else 0.0

    def _try(self, do: Callable[[], None]) -> Exception | None:
        try:
            do()
        except UserError as error:
            self.problem = str(error)
            return error
        except Exception as error:  # a page can not end with a traceback; the terminal has it
            traceback.print_exc()
            self._run(False)
            self.problem = f"{type(error).__name__}: {error}; the terminal says where"
            return error
        return None

    def _run(self, on: bool) -> None:
        self.running, self.problem, self._due = on, "", 0.0
        if not on:
            self._stop_planning()

    def _one_step(self) -> None:
        self._run(False)
        self._trial.advance()
        self.scenery = self._trial.scenery()

    def _go_on(self) -> None:
        try:
            if self.goes_on and self._trial.over:
                self._begin(self.choices.run.seed + 1)
            if self.realtime:
                self._in_time()
            else:
                self._stop_planning()
                self._trial.advance()
        except UserError:
            self._run(False)  # the same would be wrong again
            raise
        self.scenery = self._trial.scenery()

    def _in_time(self) -> None:
        trial, now = self._trial, time.monotonic()
        if self._newest is None:
            self._newest, self._due = NewestPlan(self._session.controller), now
            self._offer(self._newest)
        planned = self._newest.newest
        if planned is not None:
            late, number = now - planned.job.at, trial.number
            trial.execute(planned.action(number), planned.plan, planned.cost, 1e3 * late, number - planned.job.number)
            self._offer(self._newest)
        # A step that is itself late does not make the next ones hurry.
        self._due = max(self._due + period_of(self._session), time.monotonic())

    def _offer(self, newest: NewestPlan) -> None:
        world, here = self._trial.world, self._trial.observation
        newest.offer(self._trial.number, get_state(world.model, world.data), dict(here), self._trial.executed)

    def _stop_planning(self) -> None:
        if self._newest is not None:
            self._newest.close()
            if self._newest.number is not None:
                self._trial.planned = self._newest.number
        self._newest = None

    def _begin(self, seed: int) -> None:
        self._stop_planning()
        self.choices = self.choices.changed("seed", seed)
        self._trial = Trial(self._session, seed)
        self.problem = ""
        self.scenery = self._trial.scenery()

    def _change(self) -> None:
        with self._lock:
            asked, self._asked = self._asked, {}
        if not asked:
            return  # done with an earlier order
        choices = self.choices
        for name, value in asked.items():
            choices = choices.changed(name, value)
        # A goal put elsewhere stays there, unless it belongs to another episode now.
        moved = self._trial.observation["desired_goal"] if not {"env", "seed"} & asked.keys() else None
        session = open_session(choices)  # the old one goes on if this is impossible
        try:
            trial = Trial(session, choices.run.seed)
        except BaseException:
            session.close()
            raise
        self._stop_planning()
        self._session.close()
        self.choices, self._session, self._trial, self.problem = choices, session, trial, ""
        if moved is not None and not np.array_equal(moved, trial.observation["desired_goal"]):
            trial.move_goal(moved)
        self.scenery = trial.scenery()

    def _move_goal(self) -> None:
        with self._lock:
            goal, self._goal = self._goal, None
        if goal is not None:
            self._trial.move_goal(goal)
            self.scenery = self._trial.scenery()
