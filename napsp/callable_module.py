"""Modules that are commands, ``python -m napsp.train``, and functions, ``napsp.train(...)``, by one name."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any


class CallableModule(ModuleType):
    """A module that does what a function of :mod:`napsp.library` does when it is called."""

    _function: str

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Call the function."""
        return getattr(import_module("napsp.library"), self._function)(*args, **kwargs)


def callable_module(name: str, function: str) -> None:
    """Make the module ``name``, which is being imported, one that can be called."""
    module = sys.modules[name]
    module.__class__ = CallableModule
    module._function = function
