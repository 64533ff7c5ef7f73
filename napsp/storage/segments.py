"""What a run adds to its state between two saves: files of their own, written once and never changed.

The state file names them by kind, episodes and checksum. So a save costs what is new, and until the state file is
replaced, in one step, the last state stands, whatever was written beside it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from napsp.data.buffer import EpisodeBuffer
from napsp.data.episodes import BLOWN, FIELDS, Episodes
from napsp.distance.counts import KeyCounts
from napsp.errors import UserError
from napsp.storage.files import STATE_FORMAT, read_checked, write_tensors

FOLDER = "training_state"
"""Beside the state file."""
KINDS = ("episodes", "counts")
LARGEST = 2**26  # bytes of episodes in a file: what serialising needs a second time


@dataclass(frozen=True)
class Segment:
    """A file: what episodes ``start`` .. ``end`` - 1 of a run, by number, added.

    Attributes:
        kind: "episodes", or "counts" for the keys that were counted and how often.
        start: see above.
        end: see above.
        checksum: of the file, by :func:`napsp.storage.files.checksum_of`.
        size: of what it holds, bytes.
    """

    kind: str
    start: int
    end: int
    checksum: str
    size: int

    @property
    def name(self) -> str:
        """Of the file; made of numbers, so that no header can lead out of the folder."""
        return file_name(self.kind, self.start, self.end)


def file_name(kind: str, start: int, end: int) -> str:
    """Of a segment's file."""
    return f"{kind}-{start:08d}-{end:08d}.safetensors"


def described(segments: Iterable[Segment]) -> list[dict[str, Any]]:
    """Segments as JSON."""
    return [asdict(segment) for segment in segments]


def listed(values: Any, kind: str, path: Path) -> list[Segment]:
    """Segments of a header, each of which begins where the one before it ended, or later, for episodes that are gone.

    Raises:
        UserError: the header names none such.
    """
    try:
        found = [Segment(**value) for value in values]
        numbers = [number for segment in found for number in (segment.start, segment.end)]
        integers = [*numbers, *(segment.size for segment in found)]
        fits = all(type(number) is int and number >= 0 for number in integers) and numbers == sorted(numbers)
        fits = fits and all(segment.kind == kind and type(segment.checksum) is str for segment in found)
    except TypeError:
        fits, found = False, []
    if not fits:
        raise UserError(f"{path} does not say which files belong to it; begin anew with --restart")
    return found


def write_segment(folder: Path, kind: str, start: int, end: int, arrays: Mapping[str, np.ndarray]) -> Segment:
    """Write one file; ``folder`` is the run's."""
    own = folder / FOLDER
    own.mkdir(exist_ok=True)
    tensors = {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in arrays.items()}
    header = {"format": STATE_FORMAT, "kind": kind, "start": start, "end": end}
    checksum = write_tensors(own / file_name(kind, start, end), tensors, header)
    return Segment(kind, start, end, checksum, sum(array.nbytes for array in arrays.values()))


def read_segment(folder: Path, segment: Segment) -> dict[str, np.ndarray]:
    """The arrays of one file.

    Raises:
        UserError: it is missing, damaged, or not the one that was written.
    """
    path = folder / FOLDER / segment.name
    if not path.is_file():
        raise UserError(f"{path} is missing, a part of the run's state; put it back, or begin anew with --restart")
    try:
        tensors, _, checksum = read_checked(path, segment.kind)
    except UserError as error:
        raise UserError(f"{error}, or begin anew with --restart") from None
    if checksum != segment.checksum:
        raise UserError(f"{path} belongs to another state of the run; put back its own, or begin anew with --restart")
    return {name: tensor.numpy() for name, tensor in tensors.items()}


def write_episodes(folder: Path, episodes: Episodes, start: int) -> list[Segment]:
    """Write episodes, the first of which has number ``start``, in files of bounded size."""
    if not len(episodes):
        return []
    step = max(1, LARGEST * len(episodes) // sum(getattr(episodes, name).nbytes for name in FIELDS))
    parts = ((first, episodes[first : first + step]) for first in range(0, len(episodes), step))
    return [
        write_segment(
            folder, "episodes", start + first, start + first + len(part), {name: getattr(part, name) for name in FIELDS}
        )
        for first, part in parts
    ]


def read_episodes(folder: Path, segments: Sequence[Segment], start: int, end: int) -> Iterator[Episodes]:
    """Episodes ``start`` .. ``end`` - 1, file by file.

    Raises:
        UserError: some of them are in no file, or a file does not hold them.
    """
    reached = start
    for segment in segments:
        if segment.end <= reached or reached >= end:
            continue
        episodes = episodes_of(read_segment(folder, segment), folder / FOLDER / segment.name)
        if segment.start > reached or len(episodes) != segment.end - segment.start:
            break
        yield episodes[reached - segment.start : end - segment.start]
        reached = min(end, segment.end)
    if reached < end:
        raise UserError(f"{folder} has lost episodes {reached} to {end - 1} of its run; begin anew with --restart")


def episodes_of(arrays: Mapping[str, np.ndarray], path: Path) -> Episodes:
    """Episodes from the arrays of a file, after a look at shapes, kinds and lengths.

    Raises:
        UserError: they are no episodes.
    """
    parts = [arrays.get(name, np.empty(0, bool)) for name in FIELDS]
    observations, achieved, actions, goals, lengths, endings = parts
    fits = [part.ndim for part in parts] == [3, 3, 3, 2, 1, 1] and len({len(part) for part in parts}) == 1
    fits = fits and all(part.dtype == np.float32 for part in parts[:4])
    fits = fits and lengths.dtype == np.int64 and endings.dtype == np.uint8
    if fits:
        length = actions.shape[1]
        fits = observations.shape[1] == achieved.shape[1] == length + 1 and achieved.shape[2] == goals.shape[1]
        fits = fits and bool(((lengths >= 0) & (lengths <= length)).all()) and endings.max(initial=0) <= BLOWN
    if not fits:
        raise UserError(f"{path} does not hold episodes as a run writes them; begin anew with --restart")
    return Episodes(*parts)


def checked_table(keys: np.ndarray, counts: np.ndarray, path: Path) -> KeyCounts:
    """Counts of keys from the arrays of a file.

    Raises:
        UserError: they are none.
    """
    fits = keys.dtype == counts.dtype == np.int64 and keys.ndim == 1 and keys.shape == counts.shape
    if fits and bool((keys[1:] > keys[:-1]).all()) and counts.min(initial=1) >= 1:
        return KeyCounts(keys, counts)
    raise UserError(f"{path} does not hold counts as a run writes them; begin anew with --restart")


def refill(folder: Path, segments: Sequence[Segment], start: int, end: int, buffer: EpisodeBuffer) -> None:
    """Let D be episodes ``start`` .. ``end`` - 1.

    Raises:
        UserError: see :func:`read_episodes`.
    """
    buffer.forget(0)
    n_bytes = sum(path.stat().st_size for path in (folder / FOLDER).glob("episodes-*.safetensors"))
    for part in read_episodes(folder, segments, start, end):
        if not len(buffer):  # room for all at once, though never more than the files can hold
            own = sum(getattr(part, name).nbytes for name in FIELDS) // len(part)
            buffer.reserve(max(min(end - start, n_bytes // own), 64), part)
        buffer.extend(part)


def remove_segments(folder: Path, kept: Iterable[Segment] = ()) -> None:
    """Remove all files of this kind but those that are ``kept``, and the folder once it is empty."""
    own, names = folder / FOLDER, {segment.name for segment in kept}
    if not own.is_dir():
        return
    for path in own.iterdir():
        if _OURS.fullmatch(path.name) and path.name not in names:
            path.unlink(missing_ok=True)
    if not any(own.iterdir()):
        own.rmdir()


_OURS = re.compile(rf"\.?({'|'.join(KINDS)})-\d+-\d+\.safetensors(\.\d+\.tmp)?")
