"""Who ends a training: Ctrl-C, of which the first one asks for an orderly end, or a callback."""

from __future__ import annotations

import signal
import threading
from types import FrameType
from typing import Any

import numpy as np


class Interruption:
    """Listens for Ctrl-C until :meth:`close`: the first sets ``asked``, a second stops at once.

    Python lets nobody but the main thread handle signals. In another one, as in notebooks' executors, servers and Ray,
    nothing listens, and Ctrl-C is the main thread's to handle.
    """

    def __init__(self) -> None:
        self.asked = False
        self._previous: Any = None
        self._listens = threading.current_thread() is threading.main_thread()
        if self._listens:
            self._previous = signal.signal(signal.SIGINT, self._interrupt)

    def _interrupt(self, signum: int, frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        print("\nfinishing this iteration and saving; press Ctrl-C again to stop at once", flush=True)

    def close(self) -> None:
        """Give Ctrl-C back to who had it; None is a handler that Python did not set and cannot put back."""
        if self._listens:
            signal.signal(signal.SIGINT, signal.SIG_DFL if self._previous is None else self._previous)
            self._listens = False


def says_no(answer: Any) -> bool:
    """Whether a callback answered False, numpy's as well; a figure of 0 is no answer."""
    return isinstance(answer, bool | np.bool_) and not answer
