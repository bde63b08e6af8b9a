"""Header, parameters and data of a C3D file, read with all bounds checked.

C3D libraries accept headers that contradict the file (a truncated file, a wrong point count) without an error.
Therefore the bytes are parsed here.
"""

from __future__ import annotations

import itertools
import math
import os
import struct
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.model import strip_padding
from mocap_id.recording.sample_checks import check_rate

BLOCK = 512
MAGIC = 0x50
_MAX_DIMENSIONS = 7
PROCESSORS = {84: "Intel", 85: "DEC", 86: "MIPS"}

Value: TypeAlias = "np.ndarray[Any, Any] | tuple[str, ...]"
"""Value of a parameter: numbers with the first index varying fastest, or strings."""


@dataclass(frozen=True)
class C3DFile:
    """Open C3D file with its header (the fields of the first block) and parameters."""

    path: Path
    stream: BinaryIO
    size: int  # bytes
    processor: int
    # The header: unsigned words, and two floats converted to IEEE
    points: int
    analog_words: int
    first: int
    last: int
    scale: float
    data_block: int
    analog_per_frame: int
    rate: float
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
    points, analog_words, first, last = struct.unpack(endian(processor) + "HHHH", data[2:10])
    block, per_frame = struct.unpack(endian(processor) + "HH", data[16:20])
    scale, rate = float(convert_floats(data[12:16], processor)[0]), float(convert_floats(data[20:24], processor)[0])
    header = (points, analog_words, first, last, scale, block, per_frame, rate)
    stop = (block - 1) * BLOCK if block else start + data[start + 2] * BLOCK
    data = data[:stop] + stream.read(max(0, stop - len(data)))
    parameters, repeated = _read_parameters(path, data, start + 4, processor)
    return C3DFile(path, stream, size, processor, *header, parameters, repeated)


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
        texts = []
        for part in (raw[i * width : (i + 1) * width] for i in range(count)):
            try:
                texts.append(part.decode("utf-8"))
            except UnicodeDecodeError:
                texts.append(part.decode("latin-1"))
        return tuple(texts)
    if kind == 4:
        array: np.ndarray[Any, Any] = convert_floats(raw, processor)
    else:
        array = np.frombuffer(raw, np.int8 if kind == 1 else endian(processor) + "i2")
    return array.reshape(shape, order="F")


_PADDING = 2 * BLOCK
"""Largest padding at the end of a file, bytes: writers pad the last block, and some add another block."""

_LARGEST_COUNT = 65535


_BLOCK_BYTES = 1 << 20  # bytes of the file to decode at a time


@dataclass(frozen=True)
class Layout:
    """Arrangement of the stored data, from the declarations in the file and the size of the file."""

    points: int  # number of trajectories
    channels: int  # number of analog channels
    per_frame: int  # analog samples per frame
    frames: int  # number of frames
    first: int  # number of the first frame
    rate: float  # frames per second
    scale: float  # length units per integer count; negative in files that contain floats
    start: int  # position of the data in the file, bytes
    oddities: tuple[str, ...]  # notes on contradictions and how they were resolved

    @property
    def real(self) -> bool:
        """Whether the data are floats, not scaled 16-bit integers."""
        return self.scale < 0

    @property
    def frame_bytes(self) -> int:
        """Size of one frame, bytes."""
        return (4 * self.points + self.channels * self.per_frame) * (4 if self.real else 2)


def find_layout(file: C3DFile) -> Layout:
    """Determine the layout of a file; the size of the file decides between contradictory declarations.

    Raises RecordingError if the file is truncated, declares no frames, rate or points, or contradicts itself.
    """
    oddities = list[str]()
    scale = _read_scalar(file, "POINT:SCALE", file.scale, oddities)
    rate = _read_scalar(file, "POINT:RATE", file.rate, oddities)
    if not (np.isfinite(scale) and scale != 0.0):
        raise RecordingError(
            f"{file.path}: POINT:SCALE is {scale}, expected a non-zero number; the file is corrupt, export it again"
        )
    check_rate(file.path, rate, "the frame rate")
    # position of the data, from the header, or else from POINT:DATA_START
    declared = (file.words("POINT:DATA_START") or [0])[0]
    if declared and file.data_block and declared != file.data_block:
        oddities.append(f"POINT:DATA_START is {declared}, the header says {file.data_block}: the header was used")
    start = ((file.data_block or declared) - 1) * BLOCK
    if not 0 < start < file.size:
        raise RecordingError(
            f"{file.path}: the data should start at byte {start} of a file of {file.size} bytes; "
            "the file is truncated or corrupt, export it again"
        )
    word = 4 if scale < 0 else 2
    points, words, frames = _find_counts(file, word, file.size - start, oddities)
    size = (4 * points + words) * word

    def frame(index: int) -> bytes:
        return file.read_bytes(start + index * size, start + (index + 1) * size)

    # blank frames before the declared end; in a real frame without visible markers, every eighth byte is not 0
    blank = 0
    while blank < frames and frame(frames - blank - 1).count(0) >= 0.95 * size:
        blank += 1
    if 0 < blank < frames:
        oddities.append(
            f"the last {blank} of {frames} frames contain almost only zeros: the recording may end before them"
        )
    more = 0
    while start + (frames + more + 1) * size <= file.size and any(frame(frames + more)):
        more += 1
    if more and not any("follow the last declared frame" in oddity for oddity in oddities):
        oddities.append(f"data for {more} more frames follow the {frames} declared frames and were not read")
    channels = per_frame = 0
    if words:
        channels, per_frame = (file.words("ANALOG:USED") or [0])[0], file.analog_per_frame
        if channels and words % channels == 0:
            per_frame = words // channels
        elif per_frame and words % per_frame == 0:
            channels = words // per_frame
        else:
            raise RecordingError(
                f"{file.path}: {words} analog numbers per frame are not a multiple of {channels} channels "
                f"(ANALOG:USED) or of {per_frame} samples per frame (header); the file contradicts itself, export it "
                "again"
            )
        analog_rate = file.numbers("ANALOG:RATE")
        if analog_rate is not None and abs(float(analog_rate.ravel()[0]) - per_frame * rate) > 1e-3 * per_frame * rate:
            oddities.append(
                f"ANALOG:RATE is {float(analog_rate.ravel()[0]):g} Hz, but {per_frame} samples per frame at {rate:g} "
                f"Hz make {per_frame * rate:g} Hz: ANALOG:RATE was not used"
            )
    first, trial = file.first, read_frame_number(file, "TRIAL:ACTUAL_START_FIELD")
    if trial is not None and trial != first:
        last = read_frame_number(file, "TRIAL:ACTUAL_END_FIELD")
        first = trial if last is not None and last - trial + 1 == frames else file.first
        if file.first != _LARGEST_COUNT and trial % 65536 != file.first:
            oddities.append(
                f"the header starts at frame {file.first}, TRIAL:ACTUAL_START_FIELD at {trial}: {first} was used"
            )
    if file.repeated:
        names = ", ".join(file.repeated[:2]) + (" …" if len(file.repeated) > 2 else "")
        oddities.append(f"{len(file.repeated)} parameters occur more than once, the first was used: {names}")
    return Layout(points, channels, per_frame, frames, first, rate, scale, start, tuple(oddities))


def read_frames(file: C3DFile, layout: Layout, part: slice) -> tuple[FloatArray, FloatArray]:
    """Read the F frames in the slice ``part``; RecordingError if the file has become shorter since it was opened.

    The first array (F, points, 4) contains x, y, z in the unit of the file and the residual of every point. The second
    array (F, per_frame, channels) contains the analog samples as stored, before offset and scale are applied.
    """
    count, size = part.stop - part.start, layout.frame_bytes
    raw = file.read_bytes(layout.start + part.start * size, layout.start + part.stop * size)
    if layout.real:
        values = convert_floats(raw, file.processor)
    else:
        values = np.frombuffer(raw, endian(file.processor) + "i2").astype(np.float64)
    rows = values.reshape(count, -1)
    points = rows[:, : 4 * layout.points].reshape(count, layout.points, 4)
    analog = rows[:, 4 * layout.points :].reshape(count, layout.per_frame, layout.channels)
    if not layout.real:
        points[..., :3] *= layout.scale
        if is_unsigned(file):
            analog = analog % (1 << 16)
    return points, analog


def is_unsigned(file: C3DFile) -> bool:
    """Return whether ANALOG:FORMAT declares counts and offsets as unsigned."""
    return file.text("ANALOG:FORMAT").upper().startswith("UNSIGNED")


def _read_scalar(file: C3DFile, name: str, header: float, oddities: list[str]) -> float:
    value = file.numbers(name)
    if value is None:
        return header
    declared = float(value.ravel()[0])
    if np.isfinite(header) and abs(declared - header) > 1e-3 * abs(declared):
        oddities.append(f"{name} is {declared:g}, the header says {header:g}: the parameter was used")
    return declared


def _find_counts(file: C3DFile, word: int, available: int, oddities: list[str]) -> tuple[int, int, int]:
    """Return the numbers of points, of analog words per frame and of frames that fit the size of the file.

    The file declares each number in several fields, and all combinations are tried. ``word`` is the size of a stored
    number and ``available`` the size of all frames, bytes.
    """
    channels = (file.words("ANALOG:USED") or [])[:1]
    points = [*(file.words("POINT:USED") or [])[:1], file.points]
    words = [file.analog_words, *(count * file.analog_per_frame for count in channels)]
    frames = [file.last - file.first + 1]
    first, last = (read_frame_number(file, f"TRIAL:ACTUAL_{end}_FIELD") for end in ("START", "END"))
    if first is not None and last is not None:
        frames.append(last - first + 1)
    for name in ("POINT:FRAMES", "POINT:LONG_FRAMES"):
        frames += (file.words(name) or [])[:1]
    candidates = list(itertools.product(dict.fromkeys(points), dict.fromkeys(words), dict.fromkeys(frames)))
    candidates = [c for c in candidates if c[2] > 0 and 4 * c[0] + c[1] > 0]
    if not candidates:
        raise RecordingError(f"{file.path}: the file declares no frames or no data; export it again")
    surplus = {c: available - c[2] * (4 * c[0] + c[1]) * word for c in candidates}
    fitting = [c for c in candidates if 0 <= surplus[c] < _PADDING]
    if not fitting and _LARGEST_COUNT in frames:
        # 16-bit counters end at 65,535 frames; there may be more. Padding at the end is not counted.
        candidate = next(c for c in candidates if c[2] == _LARGEST_COUNT)
        size = (4 * candidate[0] + candidate[1]) * word
        stored, start = available // size, file.size - available
        while stored > _LARGEST_COUNT and not any(file.read_bytes(start + (stored - 1) * size, start + stored * size)):
            stored -= 1
        if stored > _LARGEST_COUNT:
            oddities.append(f"the file declares 65535 frames but contains {stored}: all were read")
            fitting = [(*candidate[:2], stored)]
            frames.append(stored)
    if not fitting and len(candidates) == 1 and surplus[candidates[0]] >= 0:
        oddities.append(f"{surplus[candidates[0]]} bytes follow the last declared frame and were not read")
        fitting = candidates
    if not fitting:
        fewest = min(candidates, key=lambda c: c[2] * (4 * c[0] + c[1]))
        size = (4 * fewest[0] + fewest[1]) * word
        if available // size < fewest[2]:
            raise RecordingError(
                f"{file.path}: truncated: the header declares {fewest[2]} frames of {size} bytes, the file contains "
                f"{available // size}; copy or export it again"
            )
        raise RecordingError(
            f"{file.path}: the file contradicts itself: no combination of its declared points, channels and frames "
            f"fits its size of {file.size} bytes; export it again"
        )
    votes = Counter(points), Counter(words), Counter(frames)
    best = max(fitting, key=lambda c: sum(vote[part] for vote, part in zip(votes, c, strict=True)))
    for name, declared, taken in zip(
        ("points", "analog words per frame", "frames"), (points, words, frames), best, strict=True
    ):
        others = sorted(set(declared) - {taken} - ({_LARGEST_COUNT} if name == "frames" else set()))
        if others:
            oddities.append(f"it declares {taken} and {', '.join(map(str, others))} {name}: {taken} fits its size")
    return best


def read_frame_number(file: C3DFile, name: str) -> int | None:
    """Return a frame number such as TRIAL:ACTUAL_END_FIELD, stored as two 16-bit words, low first; None if missing."""
    words = file.words(name)
    if not words:
        return None
    return words[0] + 65536 * words[1] if len(words) > 1 and max(words) < 65536 else words[0]


def decode_frames(
    file: C3DFile, layout: Layout, keep: Sequence[int], channels: Sequence[int], metres: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """Decode all frames of the trajectories ``keep`` and of the analog ``channels``, numbered from 0.

    The first array (frames, len(keep), 3) contains positions, m; NaN if the residual marks the point as not seen.
    ``metres`` is the length unit of the file, m. The second array (frames * per_frame, len(channels)) contains the
    analog samples as stored, before offset and scale are applied.
    """
    positions = np.empty((layout.frames, len(keep), 3))
    counts = np.empty((layout.frames, layout.per_frame, len(channels)))
    kept = slice(None) if len(keep) == layout.points else list(keep)
    step = max(1, _BLOCK_BYTES // layout.frame_bytes)
    for first in range(0, layout.frames, step):
        part = slice(first, min(first + step, layout.frames))
        points, analog = read_frames(file, layout, part)
        np.multiply(points[:, kept, :3], metres, out=positions[part])
        residual = points[:, kept, 3]  # its size and the cameras are not used
        positions[part][~(residual >= 0)] = np.nan
        counts[part] = analog[:, :, list(channels)]
    return positions, counts.reshape(layout.frames * layout.per_frame, len(channels))


def read_channel_scales(file: C3DFile, layout: Layout) -> tuple[FloatArray, FloatArray]:
    """Return offset and scale (channels,) of every channel, for the conversion ``(count - offset) * scale``.

    The offset is ANALOG:OFFSET, unsigned in a file with FORMAT UNSIGNED. The scale is ANALOG:SCALE times GEN_SCALE; it
    is NaN for a channel without a scale. Channels above 255 are in OFFSET2, SCALE2 and so on.
    """
    general = file.numbers("ANALOG:GEN_SCALE")
    gain = 1.0 if general is None else float(general.ravel()[0])
    offset = np.zeros(layout.channels)
    names = file.parts("ANALOG:OFFSET")
    declared = [file.words(name) if is_unsigned(file) else file.numbers(name) for name in names]
    stored = [np.asarray(part, dtype=np.float64).ravel() for part in declared if part is not None]
    values = np.concatenate([np.zeros(0), *stored])[: layout.channels]
    offset[: len(values)] = values
    scales = [part.ravel() for name in file.parts("ANALOG:SCALE") if (part := file.numbers(name)) is not None]
    scale = np.full(layout.channels, np.nan if scales else 1.0)
    values = np.concatenate([np.zeros(0), *scales])[: layout.channels]
    scale[: len(values)] = values
    return offset, scale * gain
