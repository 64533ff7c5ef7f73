"""Threads that share a rollout's work, where there are no helper processes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor, wait

import numpy as np

from mpc.simulators import State
from mpc.workers import Job


class ThreadWorkers:
    """Workers 0 .. n - 1 in threads of this process; see :class:`mpc.workers.ForkedWorkers`."""

    def __init__(self, job: Job, n_threads: int) -> None:
        self._job, self._n_threads = job, n_threads
        self._pool = ThreadPoolExecutor(n_threads)

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
            Exception: what the job raised.
        """
        taken = iter(samples.tolist())  # its next() is atomic
        jobs = [
            self._pool.submit(self._job, worker, state, taken, controls, features, diverged)
            for worker in range(self._n_threads)
        ]
        try:
            for job in jobs:
                job.result()
        finally:  # after a failure or Ctrl-C nobody may go on: the next call uses the same simulations
            for _ in taken:
                pass
            wait(jobs)

    def close(self) -> None:
        """Stop the threads."""
        self._pool.shutdown()
