"""The command line of every benchmark: what holds for all numbers and lists is checked here."""

from __future__ import annotations

from dataclasses import fields
from typing import TypeVar

import tyro

from napsp.errors import UserError

Options = TypeVar("Options")


def read_options(kind: type[Options], name: str, may_be_empty: tuple[str, ...] = (), **least: int) -> Options:
    """The options of ``python -m benchmarks.NAME``, a dataclass; ``least`` has bounds of whole numbers.

    Raises:
        UserError: a list without entries that is not empty by default nor in ``may_be_empty``, or a whole number
            below its bound: 0 for seeds, 1 for all others that are not in ``least``.
    """
    options = tyro.cli(kind, prog=f"python -m benchmarks.{name}")
    for field in fields(kind):  # type: ignore[arg-type]
        value, flag = getattr(options, field.name), f"--{field.name.replace('_', '-')}"
        entries = value if isinstance(value, tuple) else (value,)
        if value == () != field.default and field.name not in may_be_empty:
            raise UserError(f"{flag} is empty; give at least one value")
        numbered = field.name.endswith("seed") or (field.name.endswith("seeds") and isinstance(value, tuple))
        bound = least.get(field.name, 0 if numbered else 1)
        for entry in entries:
            if isinstance(entry, int) and not isinstance(entry, bool) and entry < bound:
                raise UserError(f"{flag} is {entry}; it must be at least {bound}")
    return options
