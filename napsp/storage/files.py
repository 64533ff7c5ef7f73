"""Files that are never half written: JSON, and safetensors with a JSON header; nothing is unpickled."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save as serialize
from torch import Tensor

from napsp.errors import UserError

FORMAT, OLDER = "napsp-2", "napsp-1"


def write_atomically(path: Path, content: bytes) -> None:
    """Replace ``path`` with ``content`` in one step: readers see the old file or the new one."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a JSON file, atomically; its folder is made when missing.

    Raises:
        UserError: ``path`` is a folder.
    """
    if path.is_dir():
        raise UserError(f"{path} is a folder; give the name of a file")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, (json.dumps(content, indent=2) + "\n").encode())


def write_tensors(path: Path, tensors: dict[str, Tensor], header: dict[str, Any]) -> None:
    """Write tensors and a JSON header as one safetensors file, atomically."""
    contiguous = {name: tensor.detach().contiguous() for name, tensor in tensors.items()}
    write_atomically(path, serialize(contiguous, metadata={"napsp": json.dumps(header)}))


def read_tensors(path: Path, kind: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read a file of :func:`write_tensors` whose header says it is of this ``kind``.

    Raises:
        UserError: the file is missing, damaged, or not one of ours.
    """
    if not path.is_file():
        raise UserError(f"no checkpoint at {path}; train one with: python -m napsp.train --env NAME")
    try:
        with safe_open(path, framework="pt") as file:
            header = json.loads((file.metadata() or {}).get("napsp", "null"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
    except (SafetensorError, ValueError) as error:
        raise UserError(f"{path} is damaged or not a safetensors file ({error}); copy or train it again") from None
    written = str(header.get("format")) if isinstance(header, dict) else ""
    if written.startswith("napsp-") and written not in (FORMAT, OLDER):
        raise UserError(f"{path} has format {written}, which this version of napsp does not know; use a newer version")
    if not written.startswith("napsp-") or header.get("kind") != kind:
        raise UserError(f"{path} is not a napsp {kind} file; train one with: python -m napsp.train --env NAME")
    return tensors, header
