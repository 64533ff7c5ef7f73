"""Errors a user can fix: commands print them as one line and exit with status 2."""

from __future__ import annotations

import difflib
import importlib
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Collection
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any


class UserError(Exception):
    """Bad input; the message is one sentence that names the fix."""


def run_command(main: Callable[[], int | None]) -> None:
    """Run a command's ``main``; turn a :class:`UserError` into one line and exit status 2."""
    before, warnings.formatwarning = warnings.formatwarning, _one_line
    try:
        _run(main)
    finally:
        warnings.formatwarning = before


def _one_line(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
) -> str:
    """A warning as a command shows it: of its own no line of source, which is nothing that its user could mend."""
    place = "" if is_ours(filename) else f"{filename}:{lineno}: {category.__name__}: "
    return f"warning: {place}{message}\n"


def _run(main: Callable[[], int | None]) -> None:
    try:
        status = main()
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:
        # Whoever read the output, such as head, has enough; what is left in the buffer has nowhere to go.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)  # as a shell reports SIGPIPE
    except FileNotFoundError as error:
        print(f"error: {error}; check the path, and the folder the command was started in", file=sys.stderr)
        sys.exit(2)
    except FileExistsError as error:
        print(f"error: {error}; choose another folder", file=sys.stderr)
        sys.exit(2)
    except OSError as error:
        # A full disk or an unwritable folder: nothing already saved was touched.
        print(f"error: {error}; free some space or choose another folder", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    sys.exit(status or 0)


def tell_of_interrupts() -> None:
    """Where ``python -m`` imports a package: let Ctrl-C end the command in a line until :func:`run_command` does."""
    if sys.argv[:1] != ["-m"]:  # what it is while the command's module is looked for
        return
    spec = find_spec(name) if (name := _asked_for()) in PACKAGES else None
    if spec is not None and spec.origin is not None and is_ours(spec.origin):
        sys.excepthook = _interrupted


def _asked_for() -> str:
    """The package that ``python -m`` was told to run; of a program of the user's own, Ctrl-C is its own affair."""
    words = iter(sys.orig_argv[1:])
    found = next((match for word in words if (match := re.fullmatch(r"-[bBdEiIOPqsSuvx]*m(.*)", word))), None)
    return ((found and found[1]) or next(words, "")).partition(".")[0]


def _interrupted(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
        return
    print("interrupted", file=sys.stderr, flush=True)
    os._exit(130)  # nothing has been begun; Python would end itself by the signal


def close(word: str, known: Collection[str]) -> str | None:
    """The known word that is most like this one, if any is."""
    return next(iter(difflib.get_close_matches(word, list(known), n=1)), None)


def choose(word: str, known: Collection[str], rest: str = "") -> str:
    """The end of a message about a word that is not known: what may have been meant, and what there is."""
    found = close(word, known)
    return f"{f'did you mean {found}? ' if found else ''}choose one of: {', '.join(known)}{rest}"


def load_module(module: str, asked: str) -> ModuleType:
    """Import a module by its name.

    Args:
        module: its name.
        asked: what the user gave, for the message.

    Raises:
        UserError: it can not be imported.
    """
    try:
        return importlib.import_module(module)
    except Exception as error:  # the module is the user's own
        raise _cannot_load(asked, error) from None


def load_object(name: str) -> Any:
    """What ``module:attribute`` names.

    Raises:
        UserError: there is no such thing.
    """
    module, _, attribute = name.partition(":")
    try:
        return getattr(load_module(module, name), attribute)
    except UserError:
        raise
    except Exception as error:  # a module's own __getattr__ may raise anything
        raise _cannot_load(name, error) from None


def _cannot_load(name: str, error: Exception) -> UserError:
    kind = "" if isinstance(error, ImportError | AttributeError | ValueError) else f"{type(error).__name__}: "
    return UserError(
        f"cannot load {name} ({kind}{error}); give module:name and start the command in the folder that holds the "
        "module"
    )


def describe_failure(error: Exception) -> str:
    """Kind and words of an error in the user's own code, and the line it comes from, if that is the user's."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    if is_ours(place.filename):
        return f"{type(error).__name__}: {error}"
    return f"{type(error).__name__}: {error} ({Path(place.filename).name}, line {place.lineno})"


def is_ours(filename: str) -> bool:
    """Whether a source file belongs to this package: by where it lies, not by what its folders are called."""
    here = Path(__file__).resolve().parents[1]  # the checkout, or site-packages
    return any(Path(filename).resolve().is_relative_to(here / package) for package in PACKAGES)


PACKAGES = ("napsp", "mpc", "planners", "benchmarks")
