"""Command lines from dataclasses, by tyro, whose refusals are one sentence that says what may have been meant."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Collection, Sequence
from typing import Annotated, Any, TypeVar

import tyro

from napsp.errors import UserError, close

T = TypeVar("T")
Flat = Annotated[T, tyro.conf.arg(prefix_name=False)]
"""An option that ``--help`` shows in the group of its dataclass and that is typed without the group's name."""


def ask(kind: Any, arguments: Sequence[str], prog: str, names: Collection[str], **settings: Any) -> Any:
    """What a command line asks for.

    Args:
        kind: what tyro makes the options of.
        arguments: the words after the command.
        prog: the command, for ``--help``.
        names: all options, such as ``samples`` and ``search.noise_scale``, for what may have been meant.
        settings: further ones of ``tyro.cli``.

    Raises:
        UserError: an option is unknown, or its value does not fit.
    """
    asked, rest = ask_in_part(kind, arguments, prog, **settings)
    if rest:
        refuse_unknown(rest, prog, names)
    return asked


def ask_in_part(kind: Any, arguments: Sequence[str], prog: str, **settings: Any) -> tuple[Any, list[str]]:
    """As :func:`ask`, with the arguments that are left over."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return tyro.cli(kind, args=arguments, prog=prog, return_unknown_args=True, **settings)
    except SystemExit as stop:
        if not stop.code:  # --help
            raise
        raise UserError(f"{_sentence(said.getvalue())}; {prog} --help lists the options") from None


def refuse_unknown(arguments: Sequence[str], prog: str, names: Collection[str]) -> None:
    """Refuse arguments that are left over.

    Raises:
        UserError: always; the message names an option that may have been meant.
    """
    options = [argument.partition("=")[0] for argument in arguments if argument.startswith("-")]
    if not options:
        raise UserError(f"{arguments[0]!r} belongs to no option; {prog} --help lists them")
    asked = options[0].lstrip("-").replace("_", "-")
    known = [name.replace("_", "-") for name in names]
    found = close(asked, known) or close(asked, [name.rpartition(".")[2] for name in known])
    full = next((name for name in known if found in (name, name.rpartition(".")[2])), None)
    hint = f"did you mean --{full}? {prog} --help" if full else f"{prog} --help"
    raise UserError(f"there is no option {options[0]}; {hint} lists the options")


def _sentence(box: str) -> str:
    """What tyro says in a framed text of several parts, of which the first is the matter."""
    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line).strip("│ ").strip() for line in box.splitlines()]
    kept: list[str] = []
    for line in lines[1:]:
        if not line.strip("─╭╮╰╯ "):
            break
        kept.append(line)
    return " ".join(kept).rstrip(".") or " ".join(box.split())
