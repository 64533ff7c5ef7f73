"""How far a planning command is, while it plans: a line that is rewritten on a terminal, one now and then elsewhere."""

from __future__ import annotations

import sys
import time

import numpy as np

from mpc.controller import Plan

ON_A_TERMINAL, ELSEWHERE = 0.2, 5.0
"""Seconds between two signs of life."""


class Ticker:
    """Looks on at every control step, and says where the episodes are; see :class:`planners.app.session.Watcher`.

    Args:
        episodes: how many there will be.
        steps: T, control steps of an episode at most.
    """

    def __init__(self, episodes: int, steps: int) -> None:
        self._episodes, self._steps = episodes, steps
        self._live = sys.stdout.isatty()
        self._done, self._step = 0, 0
        self._last = time.monotonic()

    def frame(self, observation: dict[str, np.ndarray], plan: Plan) -> None:
        """Count a control step; say so if the last word was a while ago."""
        self._step += 1
        now = time.monotonic()
        if now - self._last < (ON_A_TERMINAL if self._live else ELSEWHERE):
            return
        self._last = now
        text = f"  episode {self._done + 1:3d}/{self._episodes}  step {self._step} of at most {self._steps}"
        print(f"\r\x1b[K{text}" if self._live else text, end="" if self._live else "\n", flush=True)

    def end_episode(self) -> None:
        """Make room for the line of the episode that ended."""
        self._done, self._step, self._last = self._done + 1, 0, time.monotonic()
        self.clear()

    def clear(self) -> None:
        """Make room for a line of something else."""
        if self._live:
            print("\r\x1b[K", end="", flush=True)
