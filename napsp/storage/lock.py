"""One process at a time: locks that the system lets go of, however their holder ends."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from napsp.errors import UserError

if sys.platform != "win32":
    import fcntl


class BusyError(Exception):
    """Another process holds the lock."""


@contextmanager
def exclusive(path: Path, wait: bool) -> Iterator[None]:
    """Hold the lock file ``path``, which is made for it and goes with it; one that a kill has left behind is free.

    Raises:
        BusyError: another process, or another thread, holds it and ``wait`` is false.
    """
    if sys.platform == "win32":  # nobody is kept out there
        yield
        return
    descriptor = _locked(path, wait)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)  # still held: who waits for it finds out that it is gone
        os.close(descriptor)


def _locked(path: Path, wait: bool) -> int:
    assert sys.platform != "win32"
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            if _is(descriptor, path):
                return descriptor
        except BlockingIOError:
            os.close(descriptor)
            raise BusyError from None
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # its last holder has removed it meanwhile


def _is(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


@contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Keep every other training out of a run's folder, which is made when missing and removed if nothing is left in it.

    Raises:
        UserError: one is at work there.
    """
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with exclusive(folder / ".lock", wait=False):
            yield
    except BusyError:
        raise UserError(f"another process trains in {folder}; let it end, or choose another --out") from None
    finally:
        if made and not any(folder.iterdir()):
            folder.rmdir()
