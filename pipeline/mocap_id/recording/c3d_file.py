"""Header and parameter section of a C3D file, read with all bounds checked.

C3D libraries accept headers that contradict the file (a truncated file, a wrong point count) without an error.
Therefore the bytes are parsed here.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.units import strip_padding

BLOCK = 512
MAGIC = 0x50
_MAX_DIMENSIONS = 7
PROCESSORS = {84: "Intel", 85: "DEC", 86: "MIPS"}

Value: TypeAlias = "np.ndarray[Any, Any] | tuple[str, ...]"
"""Value of a parameter: numbers with the first index varying fastest, or strings."""


@dataclass(frozen=True)
class Header:
    """Fields of the first block: unsigned words, and two floats converted to IEEE."""

    points: int
    analog_words: int
    first: int
    last: int
    scale: float
    data_block: int
    analog_per_frame: int
    rate: float


@dataclass(frozen=True)
class C3DFile:
    """Open C3D file with its header and parameters."""

    path: Path
    stream: BinaryIO
    size: int  # bytes
    processor: int
    header: Header
    parameters: Mapping[str, Value]  # value by ``"GROUP:NAME"`` in upper case
    repeated: tuple[str, ...]  # parameters that occur more than once; the first occurrence is used

    def read_bytes(self, start: int, stop: int) -> bytes:
        """Read the bytes from ``start`` to ``stop``, or to the end of the file if it is shorter."""
        self.stream.seek(start)
        raw = self.stream.read(max(0, min(stop, self.size) - start))
        if len(raw) < min(stop, self.size) - start:
            raise RecordingError(f"{self.path}: it changed while it was being read: wait until it is complete")
        return raw

    def numbers(self, name: str) -> FloatArray | None:
        """Return a numeric parameter as floats, in its own shape; None if it is missing, empty or text.

        Values of 8 bits are read as unsigned.
        """
        value = self.parameters.get(name)
        if not isinstance(value, np.ndarray) or value.size == 0:
            return None
        return (value.view(np.uint8) if value.dtype == np.int8 else value).astype(np.float64)

    def words(self, name: str) -> list[int] | None:
        """Return a numeric parameter as integers; None if it is missing, empty, text or not finite.

        Values of 8 and 16 bits are read as unsigned.
        """
        value = self.parameters.get(name)
        if not isinstance(value, np.ndarray) or value.size == 0 or not np.isfinite(value).all():
            return None
        flat = value.ravel(order="F")
        if flat.dtype.itemsize <= 2:
            return [int(word) % (1 << 8 * flat.dtype.itemsize) for word in flat]
        return [int(word) for word in flat]

    def strings(self, name: str) -> tuple[str, ...]:
        """Return a text parameter as a tuple, which is empty if the parameter is missing or numeric."""
        value = self.parameters.get(name)
        return value if isinstance(value, tuple) else ()

    def parts(self, name: str) -> tuple[str, ...]:
        """Return the names under which a long parameter is stored: ``name``, ``name2``, ``name3`` and so on.

        A parameter has at most 255 values of a dimension, so that longer ones, such as POINT:LABELS and ANALOG:SCALE,
        continue in parameters with a number behind the name.
        """
        names = [name]
        while (following := f"{name}{len(names) + 1}") in self.parameters:
            names.append(following)
        return tuple(names)

    def text(self, name: str) -> str:
        """Return the first string of a text parameter without padding; empty if it is missing."""
        return strip_padding(next(iter(self.strings(name)), ""))


def open_c3d(path: Path, stream: BinaryIO) -> C3DFile:
    """Parse the header and the parameters of an open C3D file.

    Raises RecordingError if the file is not a C3D file or its parameter section is damaged.
    """
    size = stream.seek(0, os.SEEK_END)
    stream.seek(0)
    data = stream.read(BLOCK)
    if len(data) < BLOCK or data[1] != MAGIC:
        raise RecordingError(
            f"{path}: not a C3D file: it has {size} bytes (expected at least {BLOCK}), and its second byte is "
            f"{data[1:2].hex() or 'missing'} (hexadecimal; expected 50); "
            "export the trial again as C3D, or give a TRC file"
        )
    start = (max(data[0], 2) - 1) * BLOCK
    data += stream.read(start + 4 - BLOCK)
    processor = data[start + 3] if start + 3 < len(data) else 0
    if processor not in PROCESSORS:
        raise RecordingError(
            f"{path}: the parameter section is damaged: processor type {processor}, expected 84 (Intel), 85 (DEC) or "
            "86 (MIPS); the file is corrupt or truncated, export it again"
        )
    header = _read_header(data, processor)
    stop = (header.data_block - 1) * BLOCK if header.data_block else start + data[start + 2] * BLOCK
    data = data[:stop] + stream.read(max(0, stop - len(data)))
    parameters, repeated = _read_parameters(path, data, start + 4, processor)
    return C3DFile(path, stream, size, processor, header, parameters, repeated)


def convert_floats(raw: bytes, processor: int) -> FloatArray:
    """Convert the bytes of 32-bit floats in the format of a processor (84, 85 or 86) to an array of float64."""
    with np.errstate(invalid="ignore"):  # a damaged file may contain signalling NaN
        if processor == 85:  # DEC: 16-bit words swapped, exponent larger by two
            words = np.frombuffer(raw, "<u2").reshape(-1, 2)
            bits = (words[:, 0].astype(np.uint32) << 16) | words[:, 1]
            return np.asarray(bits.view(np.float32).astype(np.float64) / 4)
        return np.frombuffer(raw, ">f4" if processor == 86 else "<f4").astype(np.float64)


def endian(processor: int) -> str:
    """Return the byte order of a processor in the notation of struct and numpy."""
    return ">" if processor == 86 else "<"


def _read_header(data: bytes, processor: int) -> Header:
    points, analog_words, first, last = struct.unpack(endian(processor) + "HHHH", data[2:10])
    block, per_frame = struct.unpack(endian(processor) + "HH", data[16:20])
    scale, rate = float(convert_floats(data[12:16], processor)[0]), float(convert_floats(data[20:24], processor)[0])
    return Header(points, analog_words, first, last, scale, block, per_frame, rate)


def _read_parameters(path: Path, data: bytes, at: int, processor: int) -> tuple[dict[str, Value], tuple[str, ...]]:
    """Return the parameters by ``GROUP:NAME``, and the names that occur more than once.

    The section is a linked list, in which the name of a group may follow its parameters. The list ends at the first
    block of the data, because some files declare too few parameter blocks and others lack the closing zero.
    """
    groups: dict[int, str] = {}
    found: list[tuple[int, str, Value]] = []
    while at + 2 <= len(data):
        length, group = struct.unpack("bb", data[at : at + 2])
        if length == 0 or group == 0:
            break
        name_end = at + 2 + abs(length)
        if name_end + 2 > len(data):
            raise RecordingError(
                f"{path}: the parameter section runs past the end of the file; it is corrupt or truncated, export it "
                "again"
            )
        step = int(struct.unpack(endian(processor) + "H", data[name_end : name_end + 2])[0])
        name = data[at + 2 : name_end].decode("latin-1").strip().upper()
        if group < 0:
            groups.setdefault(-group, name)
        else:
            end = name_end + step if step else len(data)
            found.append((group, name, _read_value(path, name, data[name_end + 2 : end], processor)))
        if step == 0:
            break
        at = name_end + step
    values: dict[str, Value] = {}
    repeated: list[str] = []
    for group, name, value in found:
        key = f"{groups.get(group, group)}:{name}"
        if key in values:
            repeated.append(key)
        else:
            values[key] = value
    if not values:
        raise RecordingError(f"{path}: the C3D file has no parameters; it is corrupt or truncated, export it again")
    return values, tuple(repeated)


def _read_value(path: Path, name: str, data: bytes, processor: int) -> Value:
    """Decode the value of a parameter from its type, dimensions and elements; ``data`` ends at the next parameter."""
    kind, rank = struct.unpack("bB", data[:2]) if len(data) >= 2 else (0, 0)
    shape = tuple(data[2 : 2 + rank])
    size = abs(kind) * math.prod(shape)
    raw = data[2 + rank : 2 + rank + size]
    if kind not in (-1, 1, 2, 4) or len(shape) < rank or rank > _MAX_DIMENSIONS or len(raw) < size:
        raise RecordingError(
            f"{path}: the C3D parameter {name!r} is damaged (element size {kind}, dimensions {list(shape)}, "
            f"{len(data)} bytes up to the next one); the file is corrupt, export it again"
        )
    if kind == -1:
        width, count = shape[0] if shape else 1, math.prod(shape[1:])
        return tuple(_decode(raw[i * width : (i + 1) * width]) for i in range(count))
    if kind == 4:
        array: np.ndarray[Any, Any] = convert_floats(raw, processor)
    else:
        array = np.frombuffer(raw, np.int8 if kind == 1 else endian(processor) + "i2")
    return array.reshape(shape, order="F")


def _decode(raw: bytes) -> str:
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")
