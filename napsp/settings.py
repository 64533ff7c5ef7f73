"""What all configurations share: nested frozen dataclasses of plain values, addressed by dotted names.

A dotted name such as ``counts.pair_bits`` is an option on the command line (``--counts.pair-bits``), a key in a task's
card and a line of what makes a result differ from the defaults. A configuration is its own identity: two are the same
question if they differ from the defaults in the same values, so an option that is added later, with a default that
leaves things as they were, changes the identity of nothing that exists.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from napsp.errors import UserError, choose, close

C = TypeVar("C")
MANY, TINY = 10**9, 1e-12
FIRST_SEED = 90_000
"""Reset seed of the first episode of commands, and of those that published results are measured on; these seeds were
never used for tuning."""


def check_ranges(config: Any, **ranges: tuple[float, float]) -> None:
    """Check that fields lie within inclusive bounds; None passes where a field may be None.

    Raises:
        UserError: one does not; NaN never does.
    """
    for name, (low, high) in ranges.items():
        value = getattr(config, name)
        if value is not None and not low <= value <= high:  # false for NaN as well
            raise UserError(f"{name} is {value}; it must lie between {low:g} and {high:g}")


def check_choice(config: Any, **choices: tuple[str, ...]) -> None:
    """Check that fields are among the words they may be.

    Raises:
        UserError: one is not; the message lists them.
    """
    for name, words in choices.items():
        if getattr(config, name) not in words:
            raise UserError(f"unknown {name} {getattr(config, name)!r}; {choose(str(getattr(config, name)), words)}")


def to_dict(config: Any) -> dict[str, Any]:
    """Nested plain JSON types."""
    return json.loads(json.dumps(config, default=_values))


def _values(config: Any) -> dict[str, Any]:
    """As dataclasses.asdict of one level, which copies every value, and reports compare thousands of configurations."""
    return {field.name: getattr(config, field.name) for field in dataclasses.fields(config)}


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested dictionaries as one with dotted names."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= flat(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {prefix + name: value}
    return found


def changed(config: C, changes: Mapping[str, Any]) -> C:
    """A copy of a configuration with other values, by dotted names.

    Raises:
        UserError: there is no option of a name, or a value is of another kind or out of its range.
    """
    own: dict[str, Any] = {}
    kinds = _kinds(type(config))
    for name, value in changes.items():
        head, _, rest = name.partition(".")
        known = {field.name for field in dataclasses.fields(config)}  # type: ignore[arg-type]
        if head not in known:
            found = close(head, known)
            hint = f"; did you mean {found}?" if found else ""
            raise UserError(f"there is no option {name!r} in {type(config).__name__} of this version of napsp{hint}")
        own.setdefault(head, {})
        own[head] = {**own[head], rest: value} if rest else value
    for head, value in own.items():
        group = getattr(config, head)
        nested = dataclasses.is_dataclass(group) and isinstance(value, Mapping)
        own[head] = changed(group, value) if nested else of_kind(head, value, kinds.get(head, Any))
    return dataclasses.replace(config, **own)  # type: ignore[type-var]


@cache
def _kinds(config: type) -> dict[str, Any]:
    """The annotations of a configuration; reports ask thousands of times."""
    try:
        return get_type_hints(config)
    except NameError:  # names that a search of the user's own imports for a type checker alone
        return {}


def of_kind(name: str, value: Any, kind: Any) -> Any:
    """The value of an option as its field holds it: numpy's numbers as Python's, lists as tuples, 64.0 as 64.

    Raises:
        UserError: it is of another kind, or none of the words it may be.
    """
    value = value.tolist() if isinstance(value, np.generic | np.ndarray) else value
    if isinstance(value, list | tuple) and not _fits(value, kind):
        value = tuple(part.item() if isinstance(part, np.generic) else part for part in value)
    if isinstance(value, float) and value.is_integer() and not _fits(value, kind) and _fits(int(value), kind):
        value = int(value)
    if _fits(value, kind):
        return value
    if get_origin(kind) is Literal and isinstance(value, str):
        raise UserError(f"unknown {name} {value!r}; {choose(value, get_args(kind))}")
    shown = kind.__name__ if isinstance(kind, type) and not get_args(kind) else str(kind).replace("typing.", "")
    raise UserError(f"{name} is {value!r}; it must be of kind {shown}")


def _fits(value: Any, kind: Any) -> bool:
    """Whether a value is of the kind that an annotation of our configurations names; a bool is no number."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return any(_fits(value, one) for one in inner)
    if origin is Literal:
        return value in inner
    if origin is tuple:
        kinds = inner[:1] * len(value) if isinstance(value, tuple) and inner[1:] == (...,) else inner
        return isinstance(value, tuple) and len(value) == len(kinds) and all(map(_fits, value, kinds))
    if kind is Any:
        return True
    if kind in (int, float) and isinstance(value, bool):
        return False
    kind = {float: int | float, Path: str | Path, None: type(None)}.get(kind, kind)
    return not isinstance(kind, type | UnionType) or isinstance(value, kind)  # what we do not know is the user's own


def differences(config: Any, default: Any) -> dict[str, Any]:
    """The values, by dotted names, that a configuration has otherwise than ``default``."""
    own, usual = flat(to_dict(config)), flat(to_dict(default))
    return {name: value for name, value in own.items() if name not in usual or usual[name] != value}


def digest(values: Mapping[str, Any]) -> str:
    """Ten hexadecimal digits that stand for these values, in file names say."""
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:10]


def as_flags(values: Mapping[str, Any]) -> str:
    """Dotted names and values as options of a command line."""
    words = []
    for name, value in values.items():
        flag = name.replace("_", "-")
        if isinstance(value, bool):
            head, _, last = flag.rpartition(".")
            words.append(f"--{flag}" if value else f"--{head + '.' if head else ''}no-{last}")
        else:
            words.append(f"--{flag} {' '.join(map(str, value)) if isinstance(value, list | tuple) else value}")
    return " ".join(words)


def refuse_old_flags(arguments: list[str], renamed: Mapping[str, str]) -> None:
    """Refuse options that have another name now; ``renamed`` maps old to new, without leading dashes.

    Raises:
        UserError: one is used; the message says what it is called now.
    """
    for argument in arguments:
        name = argument.removeprefix("--").partition("=")[0].replace("_", "-")
        if not argument.startswith("--"):
            continue
        if name in renamed:
            raise UserError(f"--{name} is now called --{renamed[name]}")
        if name.startswith("no-") and name.removeprefix("no-") in renamed:
            head, _, last = renamed[name.removeprefix("no-")].rpartition(".")
            raise UserError(f"--{name} is now called --{head}.no-{last}")
