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
from collections.abc import Sequence
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

_PADDING = 2 * BLOCK
"""Largest padding at the end of a file, bytes: writers pad the last block, and some add another block."""

_LARGEST_COUNT = 65535
_BLOCK_BYTES = 1 << 20  # bytes of the file to decode at a time


class C3DFile:
    """An open C3D file: its parameters, and the arrangement of its data.

    The size of the file decides between contradictory declarations; ``oddities`` are notes on these contradictions and
    how they were resolved. Raises RecordingError if the file is not a C3D file, is damaged or truncated, declares no
    frames, rate or points, or contradicts itself.
    """

    points: int  # number of trajectories
    channels: int  # number of analog channels
    per_frame: int  # analog samples per frame
    frames: int  # number of frames
    first: int  # number of the first frame
    rate: float  # frames per second
    scale: float  # length units per integer count; negative in files that contain floats
    start: int  # position of the data in the file, bytes

    def __init__(self, path: Path, stream: BinaryIO) -> None:
        self.path, self.stream = path, stream
        self.oddities: list[str] = []
        self.parameters: dict[str, Value] = {}  # by ``"GROUP:NAME"`` in upper case
        self.size = stream.seek(0, os.SEEK_END)  # bytes
        stream.seek(0)
        data = stream.read(BLOCK)
        if len(data) < BLOCK or data[1] != MAGIC:
            raise RecordingError(
                f"{path}: not a C3D file: it has {self.size} bytes (expected at least {BLOCK}), and its second byte is "
                f"{data[1:2].hex() or 'missing'} (hexadecimal; expected 50); "
                "export the trial again as C3D, or give a TRC file"
            )
        start = (max(data[0], 2) - 1) * BLOCK
        data += stream.read(start + 4 - BLOCK)
        self.processor = data[start + 3] if start + 3 < len(data) else 0
        if self.processor not in PROCESSORS:
            raise RecordingError(
                f"{path}: the parameter section is damaged: processor type {self.processor}, expected 84 (Intel), 85 "
                "(DEC) or 86 (MIPS); the file is corrupt or truncated, export it again"
            )
        # The header consists of unsigned words and two floats.
        order = endian(self.processor)
        points, analog_words, first, last = struct.unpack(order + "HHHH", data[2:10])
        block, per_frame = struct.unpack(order + "HH", data[16:20])
        scale, rate = (float(convert_floats(data[at : at + 4], self.processor)[0]) for at in (12, 20))
        stop = (block - 1) * BLOCK if block else start + data[start + 2] * BLOCK
        data = data[:stop] + stream.read(max(0, stop - len(data)))
        repeated = self._read_parameters(data, start + 4)
        # Arrangement of the data
        self.scale = self._choose_scalar("POINT:SCALE", scale)
        self.rate = self._choose_scalar("POINT:RATE", rate)
        if not (np.isfinite(self.scale) and self.scale != 0.0):
            raise RecordingError(
                f"{path}: POINT:SCALE is {self.scale}, expected a non-zero number; the file is corrupt, export it again"
            )
        check_rate(path, self.rate, "the frame rate")
        declared = (self.words("POINT:DATA_START") or [0])[0]
        if declared and block and declared != block:
            self.oddities.append(f"POINT:DATA_START is {declared}, the header says {block}: the header was used")
        self.start = ((block or declared) - 1) * BLOCK
        if not 0 < self.start < self.size:
            raise RecordingError(
                f"{path}: the data should start at byte {self.start} of a file of {self.size} bytes; "
                "the file is truncated or corrupt, export it again"
            )
        self.points, words, self.frames = self._find_counts(points, analog_words, last - first + 1, per_frame=per_frame)
        self.frame_bytes = (4 * self.points + words) * (4 if self.real else 2)
        self._check_last_frames()
        self.channels = self.per_frame = 0
        if words:
            self.channels, self.per_frame = (self.words("ANALOG:USED") or [0])[0], per_frame
            if self.channels and words % self.channels == 0:
                self.per_frame = words // self.channels
            elif per_frame and words % per_frame == 0:
                self.channels = words // per_frame
            else:
                raise RecordingError(
                    f"{path}: {words} analog numbers per frame are not a multiple of {self.channels} channels "
                    f"(ANALOG:USED) or of {per_frame} samples per frame (header); the file contradicts itself, export "
                    "it again"
                )
            stated, product = self.numbers("ANALOG:RATE"), self.per_frame * self.rate
            if stated is not None and abs(float(stated.ravel()[0]) - product) > 1e-3 * self.per_frame * self.rate:
                self.oddities.append(
                    f"ANALOG:RATE is {float(stated.ravel()[0]):g} Hz, but {self.per_frame} samples per frame at "
                    f"{self.rate:g} Hz make {product:g} Hz: ANALOG:RATE was not used"
                )
        self.first, trial = first, self._read_frame_number("TRIAL:ACTUAL_START_FIELD")
        if trial is not None and trial != first:
            end = self._read_frame_number("TRIAL:ACTUAL_END_FIELD")
            self.first = trial if end is not None and end - trial + 1 == self.frames else first
            if first != _LARGEST_COUNT and trial % 65536 != first:
                self.oddities.append(
                    f"the header starts at frame {first}, TRIAL:ACTUAL_START_FIELD at {trial}: {self.first} was used"
                )
        if repeated:
            names = ", ".join(repeated[:2]) + (" …" if len(repeated) > 2 else "")
            self.oddities.append(f"{len(repeated)} parameters occur more than once, the first was used: {names}")

    def _read_parameters(self, data: bytes, at: int) -> list[str]:
        """Read the parameter section from byte ``at``, and return the names that occur more than once.

        The section is a linked list, in which the name of a group may follow its parameters. The list ends at the
        first block of the data, because some files declare too few parameter blocks and others lack the closing zero.
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
                    f"{self.path}: the parameter section runs past the end of the file; it is corrupt or truncated, "
                    "export it again"
                )
            step = int(struct.unpack(endian(self.processor) + "H", data[name_end : name_end + 2])[0])
            name = data[at + 2 : name_end].decode("latin-1").strip().upper()
            if group < 0:
                groups.setdefault(-group, name)
            else:
                end = name_end + step if step else len(data)
                value = _read_value(self.path, name, data[name_end + 2 : end], self.processor)
                found.append((group, name, value))
            if step == 0:
                break
            at = name_end + step
        repeated: list[str] = []
        for group, name, value in found:
            key = f"{groups.get(group, group)}:{name}"
            if key in self.parameters:
                repeated.append(key)
            else:
                self.parameters[key] = value
        if not self.parameters:
            raise RecordingError(
                f"{self.path}: the C3D file has no parameters; it is corrupt or truncated, export it again"
            )
        return repeated

    def _choose_scalar(self, name: str, header: float) -> float:
        """Return a parameter, or the number in the header if the parameter is missing."""
        value = self.numbers(name)
        if value is None:
            return header
        declared = float(value.ravel()[0])
        if np.isfinite(header) and abs(declared - header) > 1e-3 * abs(declared):
            self.oddities.append(f"{name} is {declared:g}, the header says {header:g}: the parameter was used")
        return declared

    def _read_frame_number(self, name: str) -> int | None:
        """Return a frame number, stored as two 16-bit words, low first; None if it is missing."""
        words = self.words(name)
        if not words:
            return None
        return words[0] + 65536 * words[1] if len(words) > 1 and max(words) < 65536 else words[0]

    def _find_counts(self, *in_header: int, per_frame: int) -> tuple[int, int, int]:
        """Return the numbers of points, of analog words per frame and of frames that fit the size of the file.

        The file declares each number in several fields, and all combinations are tried. ``in_header`` are those of the
        header.
        """
        word, available = 4 if self.real else 2, self.size - self.start  # bytes of a number, and of all frames
        channels = (self.words("ANALOG:USED") or [])[:1]
        points = [*(self.words("POINT:USED") or [])[:1], in_header[0]]
        words = [in_header[1], *(count * per_frame for count in channels)]
        frames = [in_header[2]]
        first, last = (self._read_frame_number(f"TRIAL:ACTUAL_{end}_FIELD") for end in ("START", "END"))
        if first is not None and last is not None:
            frames.append(last - first + 1)
        for name in ("POINT:FRAMES", "POINT:LONG_FRAMES"):
            frames += (self.words(name) or [])[:1]
        candidates = list(itertools.product(dict.fromkeys(points), dict.fromkeys(words), dict.fromkeys(frames)))
        candidates = [c for c in candidates if c[2] > 0 and 4 * c[0] + c[1] > 0]
        if not candidates:
            raise RecordingError(f"{self.path}: the file declares no frames or no data; export it again")
        surplus = {c: available - c[2] * (4 * c[0] + c[1]) * word for c in candidates}
        fitting = [c for c in candidates if 0 <= surplus[c] < _PADDING]
        if not fitting and _LARGEST_COUNT in frames:
            # 16-bit counters end at 65,535 frames; there may be more. Padding at the end is not counted.
            candidate = next(c for c in candidates if c[2] == _LARGEST_COUNT)
            size = (4 * candidate[0] + candidate[1]) * word
            stored = available // size
            end = self.start + stored * size
            while stored > _LARGEST_COUNT and not any(self.read_bytes(end - size, end)):
                stored, end = stored - 1, end - size
            if stored > _LARGEST_COUNT:
                self.oddities.append(f"the file declares 65535 frames but contains {stored}: all were read")
                fitting = [(*candidate[:2], stored)]
                frames.append(stored)
        if not fitting and len(candidates) == 1 and surplus[candidates[0]] >= 0:
            self.oddities.append(f"{surplus[candidates[0]]} bytes follow the last declared frame and were not read")
            fitting = candidates
        if not fitting:
            fewest = min(candidates, key=lambda c: c[2] * (4 * c[0] + c[1]))
            size = (4 * fewest[0] + fewest[1]) * word
            if available // size < fewest[2]:
                raise RecordingError(
                    f"{self.path}: truncated: the header declares {fewest[2]} frames of {size} bytes, the file "
                    f"contains {available // size}; copy or export it again"
                )
            raise RecordingError(
                f"{self.path}: the file contradicts itself: no combination of its declared points, channels and frames "
                f"fits its size of {self.size} bytes; export it again"
            )
        votes = Counter(points), Counter(words), Counter(frames)
        best = max(fitting, key=lambda c: sum(vote[part] for vote, part in zip(votes, c, strict=True)))
        for name, declared, taken in zip(
            ("points", "analog words per frame", "frames"), (points, words, frames), best, strict=True
        ):
            others = sorted(set(declared) - {taken} - ({_LARGEST_COUNT} if name == "frames" else set()))
            if others:
                self.oddities.append(
                    f"it declares {taken} and {', '.join(map(str, others))} {name}: {taken} fits its size"
                )
        return best

    def _check_last_frames(self) -> None:
        """Note blank frames before the declared end, and frames after it."""

        def frame(index: int) -> bytes:
            at = self.start + index * self.frame_bytes
            return self.read_bytes(at, at + self.frame_bytes)

        # In a real frame without visible markers, every eighth byte is not 0.
        blank = 0
        while blank < self.frames and frame(self.frames - blank - 1).count(0) >= 0.95 * self.frame_bytes:
            blank += 1
        if 0 < blank < self.frames:
            self.oddities.append(
                f"the last {blank} of {self.frames} frames contain almost only zeros: the recording may end before them"
            )
        more = 0
        while self.start + (self.frames + more + 1) * self.frame_bytes <= self.size and any(frame(self.frames + more)):
            more += 1
        if more and not any("follow the last declared frame" in oddity for oddity in self.oddities):
            self.oddities.append(
                f"data for {more} more frames follow the {self.frames} declared frames and were not read"
            )

    @property
    def real(self) -> bool:
        """Whether the data are floats, not scaled 16-bit integers."""
        return self.scale < 0

    @property
    def _unsigned(self) -> bool:
        """Whether ANALOG:FORMAT declares counts and offsets as unsigned."""
        return self.text("ANALOG:FORMAT").upper().startswith("UNSIGNED")

    def read_bytes(self, start: int, stop: int) -> bytes:
        """Read the bytes from ``start`` to ``stop``, or to the end of the file if it is shorter."""
        self.stream.seek(start)
        raw = self.stream.read(max(0, min(stop, self.size) - start))
        if len(raw) < min(stop, self.size) - start:
            raise RecordingError(f"{self.path}: it changed while it was being read: wait until it is complete")
        return raw

    def numbers(self, name: str) -> FloatArray | None:
        """Return a numeric parameter as floats, in its own shape; None if it is missing, empty or text."""
        value = self.parameters.get(name)
        if not isinstance(value, np.ndarray) or value.size == 0:
            return None
        # Values of 8 bits are read as unsigned.
        return (value.view(np.uint8) if value.dtype == np.int8 else value).astype(np.float64)

    def words(self, name: str) -> list[int] | None:
        """Return a numeric parameter as integers; None if it is missing, empty, text or not finite."""
        value = self.parameters.get(name)
        if not isinstance(value, np.ndarray) or value.size == 0 or not np.isfinite(value).all():
            return None
        flat = value.ravel(order="F")
        if flat.dtype.itemsize <= 2:  # read as unsigned
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

    def read_frames(self, part: slice) -> tuple[FloatArray, FloatArray]:
        """Read the F frames in the slice ``part``; RecordingError if the file has become shorter since it was opened.

        Returns x, y, z in the unit of the file and the residual of every point, (F, points, 4), and the analog samples
        as stored, before offset and scale are applied, (F, per_frame, channels).
        """
        count, size = part.stop - part.start, self.frame_bytes
        raw = self.read_bytes(self.start + part.start * size, self.start + part.stop * size)
        if self.real:
            values = convert_floats(raw, self.processor)
        else:
            values = np.frombuffer(raw, endian(self.processor) + "i2").astype(np.float64)
        rows = values.reshape(count, -1)
        points = rows[:, : 4 * self.points].reshape(count, self.points, 4)
        analog = rows[:, 4 * self.points :].reshape(count, self.per_frame, self.channels)
        if not self.real:
            points[..., :3] *= self.scale
            if self._unsigned:
                analog = analog % (1 << 16)
        return points, analog

    def decode_frames(
        self, keep: Sequence[int], channels: Sequence[int], metres: float = 1.0
    ) -> tuple[FloatArray, FloatArray]:
        """Decode all frames of the trajectories ``keep`` and of the analog ``channels``, numbered from 0.

        Returns positions (frames, len(keep), 3), m, NaN if the residual marks the point as not seen, and the analog
        samples as stored (frames * per_frame, len(channels)). ``metres`` is the length unit of the file, m.
        """
        positions = np.empty((self.frames, len(keep), 3))
        counts = np.empty((self.frames, self.per_frame, len(channels)))
        kept = slice(None) if len(keep) == self.points else list(keep)
        step = max(1, _BLOCK_BYTES // self.frame_bytes)
        for first in range(0, self.frames, step):
            part = slice(first, min(first + step, self.frames))
            points, analog = self.read_frames(part)
            np.multiply(points[:, kept, :3], metres, out=positions[part])
            residual = points[:, kept, 3]  # its size and the cameras are not used
            positions[part][~(residual >= 0)] = np.nan
            counts[part] = analog[:, :, list(channels)]
        return positions, counts.reshape(self.frames * self.per_frame, len(channels))

    def read_channel_scales(self) -> tuple[FloatArray, FloatArray]:
        """Return offset and scale (channels,) of every channel, for the conversion ``(count - offset) * scale``.

        The offset is ANALOG:OFFSET, unsigned in a file with FORMAT UNSIGNED. The scale is ANALOG:SCALE times GEN_SCALE;
        it is NaN for a channel without a scale. Channels above 255 are in OFFSET2, SCALE2 and so on.
        """
        general = self.numbers("ANALOG:GEN_SCALE")
        gain = 1.0 if general is None else float(general.ravel()[0])
        offset = np.zeros(self.channels)
        names = self.parts("ANALOG:OFFSET")
        declared = [self.words(name) if self._unsigned else self.numbers(name) for name in names]
        stored = [np.asarray(part, dtype=np.float64).ravel() for part in declared if part is not None]
        values = np.concatenate([np.zeros(0), *stored])[: self.channels]
        offset[: len(values)] = values
        scales = [part.ravel() for name in self.parts("ANALOG:SCALE") if (part := self.numbers(name)) is not None]
        scale = np.full(self.channels, np.nan if scales else 1.0)
        values = np.concatenate([np.zeros(0), *scales])[: self.channels]
        scale[: len(values)] = values
        return offset, scale * gain


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
