"""One compiled program for a function of tensors (``torch.compile``): what ``--compiled`` needs of it."""

from __future__ import annotations

import os
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch

from napsp.errors import UserError


def cpp_compiler() -> str | None:
    """Path of the compiler that torch would call; None if it is not there."""
    return shutil.which(os.environ.get("CXX") or {"darwin": "clang++", "win32": "cl"}.get(sys.platform, "g++"))


def compiled(function: Callable[..., Any], wanted: bool) -> Callable[..., Any]:
    """A function as one compiled program, if wanted; for arguments of one shape.

    Raises:
        UserError: there is no C++ compiler, or compiling, in the first call, fails.
    """
    if not wanted:
        return function
    if cpp_compiler() is None:
        raise UserError("--compiled needs a C++ compiler: install g++ or name one in CXX, or leave --compiled out")
    torch.compiler.reset()  # programs of earlier learners in this process count towards a limit
    program: Callable[..., Any] | None = None

    def call(*arguments: Any) -> Any:
        nonlocal program
        if program is not None:
            return program(*arguments)
        try:
            with _interruptions_deferred():
                program = torch.compile(function, fullgraph=True, dynamic=False)
                return program(*arguments)
        except RuntimeError as error:
            reason = next((line for line in str(error).splitlines() if line.strip()), type(error).__name__)
            raise UserError(
                f"compiling the updates failed ({reason}); leave --compiled out, or check the compiler "
                f"{cpp_compiler()} and delete torch's cache (TORCHINDUCTOR_CACHE_DIR, by default torchinductor_USER in "
                "the folder for temporary files): a killed run can leave half a file there"
            ) from error

    return call


@contextmanager
def _interruptions_deferred() -> Iterator[None]:
    """Ctrl-C waits until the compiler is done: it would go to the compiler, too, and kill it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # child processes inherit it
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
