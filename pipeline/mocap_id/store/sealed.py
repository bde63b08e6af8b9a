"""What stands before the HDF5 in a tree's file: a hash of all that follows, and where each value stands in it.

HDF5 lets a file begin with a block of the user's own, 512 bytes times a power of two, that every HDF5 program passes
over. Ours is text: a line with the SHA-256 of the rest of the file, a line of JSON with the provenance and, for every
dataset, its type, shape and first byte, and blanks. Values can so be read without the HDF5 library, which can loop
without end over a broken file, or one that was made to hurt.
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

from mocap_id.store.provenance import dumps

_TITLE = "mocap-id: HDF5 follows this block of text; SHA-256 of all after this line: "
_HEAD = len(_TITLE) + 64 + 1  # bytes of the first line
_SMALLEST = 512  # bytes of a block, as HDF5 wants it
_FARTHEST = 1 << 40  # bytes; no dataset begins later
_HDF5 = b"\x89HDF\r\n\x1a\n"
_TYPE = re.compile(r"<f8|<i8|\|b1|\|S[1-9][0-9]{0,8}")
_PATH = re.compile(r"[^/\0]+(/[^/\0]+){0,7}")
_DAMAGED = "is damaged or was edited: its content does not match its own hash"


@dataclass(frozen=True)
class Place:
    """Where a dataset's values stand in the file, in C order.

    Parameters
    ----------
    dtype : str
        ``<f8``, ``<i8``, ``|b1``, or ``|S`` with the bytes of each text (UTF-8, filled up with NULs).
    shape : tuple of int
    start : int
        The first byte's.
    """

    dtype: str
    shape: tuple[int, ...]
    start: int

    @property
    def size(self) -> int:
        """Number of bytes."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize


def room(places: Mapping[str, tuple[str, tuple[int, ...]]], provenance: Mapping[str, str]) -> int:
    """Bytes of a block for datasets of these types and shapes, wherever they come to stand."""
    farthest = {path: Place(dtype, shape, _FARTHEST) for path, (dtype, shape) in places.items()}
    needed, size = _HEAD + len(_index(farthest, provenance)), _SMALLEST
    while size < needed:
        size *= 2
    return size


def seal(content: bytes, size: int, places: Mapping[str, Place], provenance: Mapping[str, str]) -> bytes:
    """An HDF5 file whose first ``size`` bytes are free, with its block filled in."""
    rest = _index(places, provenance).ljust(size - _HEAD) + content[size:]
    return _head(rest) + rest


def opened(content: bytes) -> tuple[dict[str, np.ndarray[Any, Any]], dict[str, str]]:
    """Values by their paths, and the provenance.

    Strings are numpy ``U`` arrays, scalars have shape (). Nothing is taken from the file before it has proved whole,
    nothing from outside its bytes, and no more bytes than it has.

    Raises
    ------
    ValueError
        The file is damaged, or not ours; the message completes "FILE …".
    """
    if not content.startswith(_TITLE.encode()):
        if content.startswith(_HDF5):
            raise ValueError("is HDF5 without a seal: an earlier version of mocap-id or another program wrote it")
        raise ValueError("is damaged, or was not written by mocap-id: it does not begin with its seal")
    if content[:_HEAD] != _head(content[_HEAD:]):
        raise ValueError(_DAMAGED)
    try:
        index = json.loads(content[_HEAD : content.index(b"\n", _HEAD)])
        places = {path: Place(dtype, tuple(shape), start) for path, (dtype, shape, start) in index["nodes"].items()}
        provenance = {key: value for key, value in index["provenance"].items() if isinstance(value, str)}
        _check(places, len(content))
        return {path: _values(content, place) for path, place in places.items()}, provenance
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"is damaged ({str(error).partition(chr(10))[0][:200]})") from error


def _head(rest: bytes) -> bytes:
    return f"{_TITLE}{hashlib.sha256(rest).hexdigest()}\n".encode()


def _index(places: Mapping[str, Place], provenance: Mapping[str, str]) -> bytes:
    nodes = {path: (place.dtype, place.shape, place.start) for path, place in places.items()}
    return f"{dumps({'nodes': nodes, 'provenance': provenance})}\n".encode()


def _check(places: Mapping[str, Place], length: int) -> None:
    """ValueError unless every place lies within so many bytes, and no two share any."""
    for path, place in places.items():
        if not _PATH.fullmatch(path) or not _TYPE.fullmatch(place.dtype):
            raise ValueError(f"a place of a name or type that no dataset has: {path[:80]!r}, {place.dtype[:80]!r}")
        if any(type(number) is not int or not 0 <= number <= _FARTHEST for number in (*place.shape, place.start)):
            raise ValueError(f"`{path[:80]}` has a shape or place that is none")
        if place.start + place.size > length:
            raise ValueError(f"`{path[:80]}` ends after the file")
    groups = {path[: slash.start()] for path in places for slash in re.finditer("/", path)}
    if groups & places.keys():
        raise ValueError(f"`{min(groups & places.keys())[:80]}` is a dataset and a group")
    taken = sorted((place.start, place.start + place.size) for place in places.values() if place.size)
    if any(start < end for (_, end), (start, _) in pairwise(taken)):
        raise ValueError("two datasets share bytes")


def _values(content: bytes, place: Place) -> np.ndarray[Any, Any]:
    count = math.prod(place.shape)
    values = np.frombuffer(content, place.dtype, count, place.start).reshape(place.shape)
    if place.dtype == "|b1" and (values.view(np.uint8) > 1).any():
        raise ValueError("a truth value that is neither true nor false")
    return np.char.decode(values, "utf-8") if place.dtype.startswith("|S") else values.copy()
