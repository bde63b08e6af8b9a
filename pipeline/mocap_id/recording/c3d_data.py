"""Arrangement of the data in a C3D file, checked against the size of the file, and decoding of these data."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.c3d_file import BLOCK, C3DFile, convert_floats, endian
from mocap_id.recording.clock import check_rate

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
    oddities: list[str] = []
    scale, rate = _read_scale_and_rate(file, oddities)
    start = _find_data_start(file, oddities)
    word = 4 if scale < 0 else 2
    points, words, frames = _find_counts(file, word, file.size - start, oddities)
    _check_end(file, start, (4 * points + words) * word, frames, oddities)
    channels, per_frame = _find_channels(file, words, rate, oddities)
    first = _find_first_frame(file, frames, oddities)
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


def _read_scale_and_rate(file: C3DFile, oddities: list[str]) -> tuple[float, float]:
    scale = _read_scalar(file, "POINT:SCALE", file.header.scale, oddities)
    rate = _read_scalar(file, "POINT:RATE", file.header.rate, oddities)
    if not (np.isfinite(scale) and scale != 0.0):
        raise RecordingError(
            f"{file.path}: POINT:SCALE is {scale}, expected a non-zero number; the file is corrupt, export it again"
        )
    check_rate(file.path, rate, "the frame rate")
    return scale, rate


def _read_scalar(file: C3DFile, name: str, header: float, oddities: list[str]) -> float:
    value = file.numbers(name)
    if value is None:
        return header
    declared = float(value.ravel()[0])
    if np.isfinite(header) and abs(declared - header) > 1e-3 * abs(declared):
        oddities.append(f"{name} is {declared:g}, the header says {header:g}: the parameter was used")
    return declared


def _find_data_start(file: C3DFile, oddities: list[str]) -> int:
    """Return the position of the data in the file, bytes, from the header, or else from POINT:DATA_START."""
    declared = (file.words("POINT:DATA_START") or [0])[0]
    block = file.header.data_block or declared
    if declared and file.header.data_block and declared != file.header.data_block:
        oddities.append(
            f"POINT:DATA_START is {declared}, the header says {file.header.data_block}: the header was used"
        )
    start = (block - 1) * BLOCK
    if not 0 < start < file.size:
        raise RecordingError(
            f"{file.path}: the data should start at byte {start} of a file of {file.size} bytes; "
            "the file is truncated or corrupt, export it again"
        )
    return start


def _find_counts(file: C3DFile, word: int, available: int, oddities: list[str]) -> tuple[int, int, int]:
    """Return the numbers of points, of analog words per frame and of frames that fit the size of the file.

    The file declares each number in several fields, and all combinations are tried. ``word`` is the size of a stored
    number and ``available`` the size of all frames, bytes.
    """
    header, channels = file.header, (file.words("ANALOG:USED") or [])[:1]
    points = [*(file.words("POINT:USED") or [])[:1], header.points]
    words = [header.analog_words, *(count * header.analog_per_frame for count in channels)]
    frames = _list_declared_frames(file)
    candidates = list(itertools.product(dict.fromkeys(points), dict.fromkeys(words), dict.fromkeys(frames)))
    candidates = [c for c in candidates if c[2] > 0 and 4 * c[0] + c[1] > 0]
    if not candidates:
        raise RecordingError(f"{file.path}: the file declares no frames or no data; export it again")
    surplus = {c: available - c[2] * (4 * c[0] + c[1]) * word for c in candidates}
    fitting = [c for c in candidates if 0 <= surplus[c] < _PADDING]
    if not fitting and _LARGEST_COUNT in frames:
        fitting = _count_beyond_limit(file, word, available, candidates, oddities)
        frames += [c[2] for c in fitting]
    if not fitting and len(candidates) == 1 and surplus[candidates[0]] >= 0:
        oddities.append(f"{surplus[candidates[0]]} bytes follow the last declared frame and were not read")
        fitting = candidates
    if not fitting:
        raise _describe_misfit(file, word, available, candidates)
    votes = Counter(points), Counter(words), Counter(frames)
    best = max(fitting, key=lambda c: sum(vote[part] for vote, part in zip(votes, c, strict=True)))
    for name, declared, taken in zip(
        ("points", "analog words per frame", "frames"), (points, words, frames), best, strict=True
    ):
        others = sorted(set(declared) - {taken} - ({_LARGEST_COUNT} if name == "frames" else set()))
        if others:
            oddities.append(f"it declares {taken} and {', '.join(map(str, others))} {name}: {taken} fits its size")
    return best


def _check_end(file: C3DFile, start: int, size: int, frames: int, oddities: list[str]) -> None:
    """Add notes to ``oddities`` on blank frames before the declared end, and on data after it."""

    def frame(index: int) -> bytes:
        return file.read_bytes(start + index * size, start + (index + 1) * size)

    blank = 0
    # In a real frame without visible markers, every eighth byte is not 0.
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


def _count_beyond_limit(
    file: C3DFile, word: int, available: int, candidates: Iterable[tuple[int, int, int]], oddities: list[str]
) -> list[tuple[int, int, int]]:
    """Return the numbers of points, analog words and frames of a file with more frames than 16-bit counters can count.

    The list has one item; it is empty if the file contains at most 65,535 frames. Padding at the end is not counted.
    """
    points, words, _ = next(c for c in candidates if c[2] == _LARGEST_COUNT)
    frame = (4 * points + words) * word
    stored = available // frame
    start = file.size - available
    while stored > _LARGEST_COUNT and not any(file.read_bytes(start + (stored - 1) * frame, start + stored * frame)):
        stored -= 1
    if stored <= _LARGEST_COUNT:
        return []
    oddities.append(f"the file declares 65535 frames but contains {stored}: all were read")
    return [(points, words, stored)]


def _describe_misfit(
    file: C3DFile, word: int, available: int, candidates: Iterable[tuple[int, int, int]]
) -> RecordingError:
    points, words, frames = min(candidates, key=lambda c: c[2] * (4 * c[0] + c[1]))
    frame = (4 * points + words) * word
    stored = available // frame
    if stored < frames:
        return RecordingError(
            f"{file.path}: truncated: the header declares {frames} frames of {frame} bytes, the file contains "
            f"{stored}; copy or export it again"
        )
    return RecordingError(
        f"{file.path}: the file contradicts itself: no combination of its declared points, channels and frames fits "
        f"its size of {file.size} bytes; export it again"
    )


def _list_declared_frames(file: C3DFile) -> list[int]:
    header = file.header
    declared = [header.last - header.first + 1]
    first, last = read_frame_number(file, "TRIAL:ACTUAL_START_FIELD"), read_frame_number(file, "TRIAL:ACTUAL_END_FIELD")
    if first is not None and last is not None:
        declared.append(last - first + 1)
    for name in ("POINT:FRAMES", "POINT:LONG_FRAMES"):
        declared += (file.words(name) or [])[:1]
    return declared


def read_frame_number(file: C3DFile, name: str) -> int | None:
    """Return a frame number such as TRIAL:ACTUAL_END_FIELD, stored as two 16-bit words, low first; None if missing."""
    words = file.words(name)
    if not words:
        return None
    return words[0] + 65536 * words[1] if len(words) > 1 and max(words) < 65536 else words[0]


def _find_first_frame(file: C3DFile, frames: int, oddities: list[str]) -> int:
    header, trial = file.header.first, read_frame_number(file, "TRIAL:ACTUAL_START_FIELD")
    if trial is None or trial == header:
        return header
    last = read_frame_number(file, "TRIAL:ACTUAL_END_FIELD")
    taken = trial if last is not None and last - trial + 1 == frames else header
    if header != _LARGEST_COUNT and trial % 65536 != header:
        oddities.append(f"the header starts at frame {header}, TRIAL:ACTUAL_START_FIELD at {trial}: {taken} was used")
    return taken


def _find_channels(file: C3DFile, words: int, rate: float, oddities: list[str]) -> tuple[int, int]:
    """Return the number of analog channels and the number of samples per frame."""
    if words == 0:
        return 0, 0
    used = (file.words("ANALOG:USED") or [0])[0]
    per_frame = file.header.analog_per_frame
    if used and words % used == 0:
        per_frame = words // used
    elif per_frame and words % per_frame == 0:
        used = words // per_frame
    else:
        raise RecordingError(
            f"{file.path}: {words} analog numbers per frame are not a multiple of {used} channels (ANALOG:USED) or of "
            f"{per_frame} samples per frame (header); the file contradicts itself, export it again"
        )
    declared = file.numbers("ANALOG:RATE")
    if declared is not None and abs(float(declared.ravel()[0]) - per_frame * rate) > 1e-3 * per_frame * rate:
        oddities.append(
            f"ANALOG:RATE is {float(declared.ravel()[0]):g} Hz, but {per_frame} samples per frame at {rate:g} Hz make "
            f"{per_frame * rate:g} Hz: ANALOG:RATE was not used"
        )
    return used, per_frame


def decode(
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


def read_calibration(file: C3DFile, layout: Layout) -> tuple[FloatArray, FloatArray]:
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
