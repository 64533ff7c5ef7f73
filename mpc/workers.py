"""Forked helper processes that share a rollout's work with this one through shared memory.

Threads would do, were it not for Python's reference counts: two cores that keep counting the
same objects slow each other down, though each is inside MuJoCo nearly all the time.
"""

from __future__ import annotations

import ctypes
import math
import mmap
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
import warnings
import weakref
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np

from mpc.simulators import State

CAN_FORK = sys.platform == "linux"  # elsewhere system libraries do not survive a fork; threads do the work there

LOCK_SECONDS = 60.0  # far longer than anyone holds the lock, unless it died with it
QUIET_SECONDS = 5.0  # how long a helper that owes an answer may sleep without computing anything
PR_SET_PDEATHSIG = 1

Job = Callable[[int, State, Iterable[int], np.ndarray, np.ndarray, np.ndarray], None]
"""Called with worker, state, the samples to simulate, controls ``(N, H, U)``, features ``(N, H, F)`` and
whether they blew up, ``(N,)``, 0 or 1; fills in its samples' rows of the last two."""


class StuckError(RuntimeError):
    """A helper waits for something that will never come."""


class ForkedWorkers:
    """Helpers 1 .. n_helpers of a caller that is worker 0.

    A helper is a copy of this process as it is now, so ``job`` may be bound to anything, and
    what changes here later is not seen there. A fork loses the threads that libraries such as torch have started: a
    job that asks for them waits for ever, which is noticed. Helpers end with this process, however it ends, and with
    this object, where nobody closes it.

    Args:
        job: what every worker runs on its own share.
        n_helpers: processes to fork.
        n_steps: the most control steps, N times H, of one call.
        n_controls: U, floats per control step that go in.
        n_features: F, floats per control step that come out.
    """

    def __init__(self, job: Job, n_helpers: int, n_steps: int, n_controls: int, n_features: int) -> None:
        self._job = job
        sizes = n_controls, n_features, 1
        self._shared = [_shared_memory(n_steps * size) for size in sizes]
        self._n_taken = _shared_memory(1).view(np.int64)
        self._pipes: list[Connection] = []
        self._theirs: list[Connection] = []
        self._processes: list[BaseProcess] = []
        self.cpu_seconds = 0.0  # CPU time of the helpers so far
        context = multiprocessing.get_context("fork")
        self._caller = os.getpid()
        self._lock = context.Lock()
        for worker in range(1, n_helpers + 1):
            ours, theirs = context.Pipe()
            self._processes.append(context.Process(target=self._serve, args=(worker, ours, theirs), daemon=True))
            self._pipes.append(ours)
            self._theirs.append(theirs)
        closed = threading.Event()
        self._end = weakref.finalize(self, _end, self._caller, self._processes, self._pipes, closed)
        self._end.atexit = False  # helpers see for themselves that their caller ends
        if threading.current_thread() is threading.main_thread():
            self._fork()
        else:  # helpers end with the thread that forked them, and the caller's may end sooner
            forked: Future[None] = Future()
            threading.Thread(target=_fork_and_stay, args=([self._fork], forked, closed), daemon=True).start()
            forked.result()

    def _fork(self) -> None:
        for process, theirs in zip(self._processes, self._theirs, strict=True):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12 warns of any thread, see above
                process.start()
            theirs.close()

    def fit(self, controls: np.ndarray) -> bool:
        """Whether there is room for controls ``(N, H, U)``."""
        return controls.size <= len(self._shared[0])

    def alive(self) -> bool:
        """Whether all helpers still run."""
        return all(process.is_alive() for process in self._processes)

    def run(
        self,
        state: State,
        samples: np.ndarray,
        controls: np.ndarray,
        features: np.ndarray,
        diverged: np.ndarray,
    ) -> None:
        """Simulate ``samples`` on all workers.

        Raises:
            StuckError: a helper neither computes nor answers; close, and simulate without helpers.
            RuntimeError: a helper has died or failed; close and fork anew.
            Exception: what the job raised here.
        """
        shared = self._views(controls.shape, features.shape)
        shared[0][:] = controls
        self._n_taken[0] = 0
        try:
            for pipe in self._pipes:
                pipe.send((state, samples, controls.shape, features.shape))
            self._job(0, state, self._take(samples), *shared)
            for pipe, process in zip(self._pipes, self._processes, strict=True):
                _await(pipe, process)
                reply = pipe.recv()
                if isinstance(reply, str):
                    raise RuntimeError(f"a simulation process failed:\n{reply}")
                self.cpu_seconds += reply
        except (EOFError, ConnectionError):
            raise RuntimeError("a simulation process has died (out of memory?); use one thread") from None
        features[samples], diverged[samples] = shared[1][samples], shared[2][samples]

    def close(self) -> None:
        """End the helpers, whatever they are at; they own nothing."""
        self._end()

    def _take(self, samples: np.ndarray) -> Iterator[int]:
        """One sample at a time, until the workers together have taken all: contact-rich ones take longer."""
        while True:
            if not self._lock.acquire(timeout=LOCK_SECONDS):
                raise RuntimeError("a simulation process has died (out of memory?); use one thread")
            taken = int(self._n_taken[0])
            self._n_taken[0] += 1
            self._lock.release()
            if taken >= len(samples):
                return
            yield int(samples[taken])

    def _views(self, controls: tuple[int, ...], features: tuple[int, ...]) -> list[np.ndarray]:
        shapes = controls, features, features[:1]
        return [memory[: math.prod(s)].reshape(s) for memory, s in zip(self._shared, shapes, strict=True)]

    def _serve(self, worker: int, callers_end: Connection, pipe: Connection) -> None:
        """Life of a helper: until its pipe closes, because the caller has gone."""
        # Also where the caller is killed, or this one stuck.
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != self._caller:  # it ended before that
            os._exit(1)
        callers_end.close()
        # What the caller has open would otherwise stay open here, such as the pipe to a video encoder that waits
        # for its end. Locks and shared memory need no descriptor.
        os.closerange(3, pipe.fileno())
        os.closerange(pipe.fileno() + 1, os.sysconf("SC_OPEN_MAX"))
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the caller's to handle
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        while True:
            try:
                state, samples, *shapes = pipe.recv()
            except EOFError:
                return
            start = time.process_time()
            try:
                self._job(worker, state, self._take(samples), *self._views(*shapes))
            except Exception:  # told to the caller
                pipe.send(traceback.format_exc())
            else:
                pipe.send(time.process_time() - start)


def _fork_and_stay(fork: list[Callable[[], None]], forked: Future[None], closed: threading.Event) -> None:
    """Life of the thread that helpers end with; it keeps alive nothing that would end them when nobody has it."""
    try:
        forked.set_result(fork.pop()())
    except BaseException as error:
        forked.set_exception(error)
    del forked
    closed.wait()


def _end(caller: int, processes: list[BaseProcess], pipes: list[Connection], closed: threading.Event) -> None:
    """End helpers, and the thread that waits for that; a fork of their caller leaves them alone."""
    if os.getpid() != caller:
        return
    started = [process for process in processes if process.pid is not None]
    for process in started:
        process.kill()
    for process in started:
        process.join()
    for pipe in pipes:
        pipe.close()
    processes.clear()
    pipes.clear()
    closed.set()


def _await(pipe: Connection, process: BaseProcess) -> None:
    """Wait for an answer, or for the end of the helper, which closes the pipe.

    Raises:
        StuckError: the helper sleeps and has used no CPU time for a while.
    """
    seen, since = None, time.monotonic()
    while not pipe.poll(0.2):
        now = _activity(process.pid)
        if now is None or now != seen:
            seen, since = now, time.monotonic()
        elif time.monotonic() - since > QUIET_SECONDS:
            raise StuckError(
                "the task's simulation waits for ever in a forked process, as a library with threads of its own does"
            )


def _activity(pid: int | None) -> tuple[str, ...] | None:
    """CPU time that a sleeping process has used; None while it runs or waits for a core."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:  # it has ended
        return None
    return tuple(fields[11:13]) if fields[0] == "S" else None


def _shared_memory(n: int) -> np.ndarray:
    """Float64 numbers ``(n,)`` that forked processes share; anonymous, so they end with the last of them."""
    return np.frombuffer(mmap.mmap(-1, 8 * n))
