"""User block of a tree's HDF5 file: a hash of the rest of the file, and an index of its datasets.

An HDF5 file may begin with a user block, which HDF5 programs skip; its size is 512 bytes times a power of two. The
block of mocap-id is text: a line with the SHA-256 of the rest of the file, and a line of JSON, padded with blanks. The
JSON contains the provenance, and the type, shape and position of every dataset. With this index, values can be read
without the HDF5 library, which may loop forever over a damaged or malicious file.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from mocap_id.errors import first_line
from mocap_id.store.provenance import dumps

_TITLE = "mocap-id: HDF5 follows this block of text; SHA-256 of all after this line: "
_HEAD = len(_TITLE) + 64 + 1  # bytes of the first line
_SMALLEST = 512  # bytes, the smallest user block of HDF5
_FARTHEST = 1 << 40  # bytes; largest offset of a dataset
_HDF5 = b"\x89HDF\r\n\x1a\n"
_TYPE = re.compile(r"<f8|<i8|\|b1|\|S[1-9][0-9]{0,8}")
_PATH = re.compile(r"[^/\0]+(/[^/\0]+){0,7}")
_DAMAGED = "is damaged or was edited: its content does not match its own hash"


@dataclass(frozen=True)
class Place:
    """Position of a dataset's values in the file, in C order."""

    dtype: str  # ``<f8``, ``<i8``, ``|b1``, or ``|S`` and the bytes of each text (UTF-8, padded with NULs)
    shape: tuple[int, ...]
    start: int  # offset of the first byte

    @property
    def size(self) -> int:
        """Number of bytes."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize


def compute_block_size(places: Mapping[str, tuple[str, tuple[int, ...]]], provenance: Mapping[str, str]) -> int:
    """Return the size of a block that can index datasets of these types and shapes at any offset, bytes."""
    farthest = {path: Place(dtype, shape, _FARTHEST) for path, (dtype, shape) in places.items()}
    needed, size = _HEAD + len(_format_index(farthest, provenance)), _SMALLEST
    while size < needed:
        size *= 2
    return size


def fill_block(content: bytes, size: int, places: Mapping[str, Place], provenance: Mapping[str, str]) -> bytes:
    """Return the bytes of an HDF5 file in which the block replaces the first ``size`` bytes, which are free."""
    rest = _format_index(places, provenance).ljust(size - _HEAD) + content[size:]
    return _format_head(rest) + rest


def read(content: bytes) -> tuple[dict[str, np.ndarray[Any, Any]], dict[str, str]]:
    """Return the datasets by path, and the provenance, from the bytes of a file.

    Texts are numpy ``U`` arrays, scalars have shape (). The hash is checked first, then that every dataset lies within
    the file. Raises ValueError if the file is damaged or from another program. The message has no subject, because the
    caller writes the file name before it.
    """
    if not content.startswith(_TITLE.encode()):
        if content.startswith(_HDF5):
            raise ValueError("is HDF5 without the hash of mocap-id: an earlier version or another program wrote it")
        raise ValueError("is damaged, or was not written by mocap-id: it does not begin with its hash")
    if content[:_HEAD] != _format_head(content[_HEAD:]):
        raise ValueError(_DAMAGED)
    try:
        index = json.loads(content[_HEAD : content.index(b"\n", _HEAD)])
        places = {path: Place(dtype, tuple(shape), start) for path, (dtype, shape, start) in index["nodes"].items()}
        provenance = {key: value for key, value in index["provenance"].items() if isinstance(value, str)}
        _check_places(places, len(content))
        return {path: _read_values(content, place) for path, place in places.items()}, provenance
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"is damaged ({first_line(error)[:200]})") from error


def _format_head(rest: bytes) -> bytes:
    return f"{_TITLE}{hashlib.sha256(rest).hexdigest()}\n".encode()


def _format_index(places: Mapping[str, Place], provenance: Mapping[str, str]) -> bytes:
    nodes = {path: (place.dtype, place.shape, place.start) for path, place in places.items()}
    return f"{dumps({'nodes': nodes, 'provenance': provenance})}\n".encode()


def _check_places(places: Mapping[str, Place], length: int) -> None:
    """Raise ValueError unless every dataset lies within ``length`` bytes and no two overlap."""
    for path, place in places.items():
        if not _PATH.fullmatch(path) or not _TYPE.fullmatch(place.dtype):
            raise ValueError(f"a dataset has an invalid name or type: {path[:80]!r}, {place.dtype[:80]!r}")
        if any(type(number) is not int or not 0 <= number <= _FARTHEST for number in (*place.shape, place.start)):
            raise ValueError(f"`{path[:80]}` has an invalid shape or offset")
        if place.start + place.size > length:
            raise ValueError(f"`{path[:80]}` ends after the end of the file")
    groups = {path[: slash.start()] for path in places for slash in re.finditer("/", path)}
    if groups & places.keys():
        raise ValueError(f"`{min(groups & places.keys())[:80]}` is both a dataset and a group")
    taken = sorted((place.start, place.start + place.size) for place in places.values() if place.size)
    if any(start < end for (_, end), (start, _) in pairwise(taken)):
        raise ValueError("two datasets share bytes")


def _read_values(content: bytes, place: Place) -> np.ndarray[Any, Any]:
    count = math.prod(place.shape)
    values = np.frombuffer(content, place.dtype, count, place.start).reshape(place.shape)
    if place.dtype == "|b1" and (values.view(np.uint8) > 1).any():
        raise ValueError("a truth value that is neither true nor false")
    return np.char.decode(values, "utf-8") if place.dtype.startswith("|S") else values.copy()
