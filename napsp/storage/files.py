"""Files that are never half written: JSON, and safetensors with a JSON header; nothing is unpickled."""

from __future__ import annotations

import csv
import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as serialize
from torch import Tensor

from napsp.errors import UserError

OLDER, FORMAT, STATE_FORMAT = "napsp-1", "napsp-2", "napsp-3"
"""Models of before, models and the states of before, states."""
KNOWN = (OLDER, FORMAT, STATE_FORMAT)


def write_atomically(path: Path, content: bytes) -> None:
    """Replace ``path`` with ``content`` in one step: readers see the old file or the new one."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
        _sync_folder(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def _sync_folder(folder: Path) -> None:
    """Let new names in a folder outlive a power failure, in the order they were made in."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a JSON file, atomically; its folder is made when missing.

    Raises:
        UserError: ``path`` is a folder.
    """
    if path.is_dir():
        raise UserError(f"{path} is a folder; give the name of a file")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, (json.dumps(content, indent=2) + "\n").encode())


def read_json(path: Path, fix: str) -> dict[str, Any]:
    """Read a JSON file that holds an object.

    Args:
        path: the file.
        fix: what to do about a damaged one, for the message.

    Raises:
        UserError: it is damaged.
    """
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise UserError(f"{path} is damaged; {fix}")
    return content


@contextmanager
def sound(path: Path, fix: str) -> Iterator[None]:
    """Whatever cannot be made of a file's content, because it is cut, forged or foreign, becomes one sentence.

    Raises:
        UserError: reading what ``path`` held failed; ``fix`` says what to do then.
    """
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError, csv.Error) as error:
        what = next(iter(str(error).splitlines()), "")  # torch adds its stack to some
        raise UserError(f"{path} does not hold what it should ({type(error).__name__}: {what}); {fix}") from None


def write_tensors(path: Path, tensors: dict[str, Tensor], header: dict[str, Any]) -> str:
    """Write tensors and a JSON header as one safetensors file, atomically; returns the checksum of both."""
    contiguous = {name: tensor.detach().contiguous().cpu() for name, tensor in tensors.items()}
    text = json.dumps(header)
    checksum = checksum_of(contiguous, text)
    write_atomically(path, serialize(contiguous, metadata={"napsp": text, "sha256": checksum}))
    return checksum


def checksum_of(tensors: dict[str, Tensor], text: str) -> str:
    """SHA-256 of a header's text and of names, kinds, shapes and numbers of tensors, hexadecimal."""
    digest = hashlib.sha256(text.encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(f"\n{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        if tensor.numel():  # numpy and torch disagree on the strides of nothing
            digest.update(tensor.contiguous().reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()


def read_tensors(path: Path, kind: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read a file of :func:`write_tensors` whose header says it is of this ``kind``.

    Raises:
        UserError: the file is missing, damaged, or not one of ours.
    """
    tensors, header, _ = read_checked(path, kind)
    return tensors, header


def read_checked(path: Path, kind: str) -> tuple[dict[str, Tensor], dict[str, Any], str]:
    """As :func:`read_tensors`, and the checksum; "" of files that were written without one.

    Raises:
        UserError: see :func:`read_tensors`.
    """
    if not path.is_file():
        raise UserError(f"no checkpoint at {path}; train one with: python -m napsp.train --env NAME")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            text, checksum = metadata.get("napsp", "null"), metadata.get("sha256", "")
            header = json.loads(text)
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
        fits = not checksum or checksum == checksum_of(tensors, text)
    except (SafetensorError, ValueError, RuntimeError, RecursionError) as error:
        raise UserError(f"{path} is damaged or not a safetensors file ({error}); copy or train it again") from None
    written = str(header.get("format")) if isinstance(header, dict) else ""
    if written.startswith("napsp-") and written not in KNOWN:
        raise UserError(f"{path} has format {written}, which this version of napsp does not know; use a newer version")
    if not written.startswith("napsp-") or header.get("kind") != kind:
        raise UserError(f"{path} is not a napsp {kind} file; train one with: python -m napsp.train --env NAME")
    if not fits:
        raise UserError(f"{path} is damaged: its checksum does not fit its content; copy or train it again")
    return tensors, header, checksum
