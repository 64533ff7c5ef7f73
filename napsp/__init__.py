"""Neural all-pairs shortest paths: learned distances d(s, a, g), the policies they train, and plans made with them."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

from napsp.errors import tell_of_interrupts

if TYPE_CHECKING:
    from napsp.library import Distance, Gradient, evaluate, load, make
    from napsp.train import train

try:
    __version__ = version("napsp")
except PackageNotFoundError:  # a source tree that was never installed
    __version__ = "unknown"
__all__ = ["Distance", "Gradient", "__version__", "evaluate", "load", "make", "train"]
tell_of_interrupts()


def __getattr__(name: str) -> Any:
    """Import what is asked for, and torch and MuJoCo with it, at its first use."""
    if name in ("Distance", "Gradient", "load", "make"):
        return getattr(import_module("napsp.library"), name)
    if name in ("evaluate", "train"):  # modules, which are commands, and can be called
        return import_module(f"napsp.{name}")
    raise AttributeError(f"module 'napsp' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
