"""Ways in which files get damaged, by accident or on purpose."""

import copy
import json
import struct

import torch
from safetensors import safe_open
from safetensors.torch import save

from napsp.storage.files import checksum_of

HUGE = (2**31, 2**40, 10**12, 2**63 - 1, 10**30)
STRANGE = (None, True, -1, 0, 0.5, 1e308, float("nan"), "", "x", "../../etc/passwd", "/", [], {}, [[]], [None], *HUGE)


def cut(data, rng):
    return data[: rng.integers(len(data))]


def flipped(data, rng):
    """Up to eight bits, half of them near the beginning, where headers are."""
    changed = bytearray(data)
    for _ in range(rng.integers(1, 9)):
        limit = len(data) if rng.random() < 0.5 else min(len(data), 400)
        changed[rng.integers(limit)] ^= 1 << rng.integers(8)
    return bytes(changed)


def overwritten(data, rng):
    start, n = rng.integers(len(data)), rng.integers(1, 200)
    filler = bytes(n) if rng.random() < 0.5 else rng.bytes(n)
    return data[:start] + filler + data[start + n :]


def grown(data, rng):
    start = rng.integers(len(data))
    part = data[start : start + rng.integers(1, 500)]
    return data[:start] + part + data[start:]


def foreign(data, rng):
    return [b"", b"{}", b"[]", b"null", b"PK\x03\x04", rng.bytes(64), b"\x80\x04\x95", b"[" * 100_000][rng.integers(8)]


def long_header(data, rng):
    """A declared size of the header that is not its own."""
    return struct.pack("<Q", int(rng.choice([0, 1, 2**20, 2**32, 2**63, len(data)]))) + data[8:]


def declared(data, rng):
    """Shapes, kinds and places of tensors that are not theirs."""
    n = struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8 : 8 + n])
    name = str(rng.choice([key for key in header if key != "__metadata__"]))
    entry = header[name]
    kind = rng.integers(4)
    if kind == 0:
        entry["shape"] = [int(rng.choice([0, 1, 7, *HUGE[:4]])) for _ in range(rng.integers(0, 4))]
    elif kind == 1:
        entry["dtype"] = str(rng.choice(["F64", "F32", "BF16", "I64", "U8", "BOOL", "F8_E4M3", "X"]))
    elif kind == 2:
        entry["data_offsets"] = [int(rng.choice([0, 8, *HUGE[:4]])), int(rng.choice([0, 8, *HUGE[:4]]))]
    else:
        header["../../outside"] = header.pop(name)
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + data[8 + n :]


def paths_of(value, path=()):
    """Every place in nested JSON."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield from paths_of(inner, (*path, key))


def forged_json(value, rng):
    """Nested JSON with one of its values gone or replaced."""
    places, value = list(paths_of(value))[1:], copy.deepcopy(value)
    *outer, last = places[rng.integers(len(places))]
    inner = value
    for key in outer:
        inner = inner[key]
    if rng.random() < 0.25:
        del inner[last]
    else:
        inner[last] = STRANGE[rng.integers(len(STRANGE))]
    return value


def forged_text(data, rng):
    return json.dumps(forged_json(json.loads(data), rng)).encode()


def forged(path, rng):
    """The file with another header or another tensor, and a checksum that fits."""
    with safe_open(path, "pt") as file:
        header = json.loads(file.metadata()["napsp"])
        tensors = {name: file.get_tensor(name).clone() for name in file.keys()}  # noqa: SIM118
    if rng.random() < 0.6:
        header = forged_json(header, rng)
    else:
        name = str(rng.choice(sorted(tensors)))
        tensor = tensors.pop(name)
        kinds = (
            lambda: None,
            lambda: tensor.double() if tensor.is_floating_point() else tensor.float(),
            lambda: torch.zeros(3, 3),
            lambda: tensor.reshape(-1)[1:] + 0,
            lambda: torch.cat([tensor.reshape(-1)] * 2),
            lambda: torch.full_like(tensor, float("nan")) if tensor.is_floating_point() else tensor.flip(0),
            lambda: torch.full_like(tensor, 2**62) if tensor.dtype == torch.int64 else -tensor,
        )
        found = kinds[rng.integers(len(kinds))]()
        if found is not None:
            tensors[name] = found
    text = json.dumps(header)
    return save(tensors, {"napsp": text, "sha256": checksum_of(tensors, text)})


ANY = (cut, flipped, overwritten, grown, foreign)


def mutated(path, data, rng):
    """One mutation of a file of content ``data`` that lies at ``path``, and its name."""
    kinds = [*ANY]
    if path.suffix == ".safetensors":
        kinds += [long_header, declared, declared]
        if rng.random() < 0.4:
            return forged(path, rng), "forged"
    elif path.suffix == ".json":
        kinds += [forged_text] * 5
    kind = kinds[rng.integers(len(kinds))]
    return kind(data, rng), kind.__name__
