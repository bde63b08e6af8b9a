"""How many points, channels and frames a C3D file really holds: its declarations against each other and its size."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.c3d_file import BLOCK, PROCESSORS, C3DFile, endian, floats

_PADDING = 2 * BLOCK
"""Writers fill up the last block, some add one."""

_SATURATED = 65535


@dataclass(frozen=True)
class Layout:
    """The stored data, established from the declarations and the file's size.

    Parameters
    ----------
    points, channels, per_frame, frames, first : int
        Trajectories, analog channels, analog samples a frame, frames, number of the first frame.
    rate : float
        Frames per second.
    scale : float
        Length units per integer count; negative for files that hold floats.
    start : int
        Offset of the data in the file, bytes.
    oddities : tuple of str
        Contradictions and how they were settled.
    """

    points: int
    channels: int
    per_frame: int
    frames: int
    first: int
    rate: float
    scale: float
    start: int
    oddities: tuple[str, ...]

    @property
    def real(self) -> bool:
        """The data are floats, not scaled 16-bit integers."""
        return self.scale < 0

    @property
    def word(self) -> int:
        """Bytes of a stored number."""
        return 4 if self.real else 2

    @property
    def frame_bytes(self) -> int:
        """Bytes of one frame."""
        return (4 * self.points + self.channels * self.per_frame) * self.word


def establish(file: C3DFile) -> Layout:
    """Settle what the file holds.

    Raises
    ------
    RecordingError
        The file is shorter than it promises, declares no frames, no rate or no points, or contradicts itself.
    """
    oddities: list[str] = []
    scale, rate = _scale_and_rate(file, oddities)
    start = _data_start(file, oddities)
    word = 4 if scale < 0 else 2
    points, words, frames = _counts(file, word, file.size - start, oddities)
    _look_at_the_end(file, start, (4 * points + words) * word, frames, oddities)
    channels, per_frame = _channels(file, words, rate, oddities)
    first = _first_frame(file, frames, oddities)
    if file.repeated:
        names = ", ".join(file.repeated[:2]) + (" …" if len(file.repeated) > 2 else "")
        oddities.append(f"{len(file.repeated)} parameters occur more than once, the first was taken: {names}")
    return Layout(points, channels, per_frame, frames, first, rate, scale, start, tuple(oddities))


def encoding(file: C3DFile, layout: Layout) -> str:
    """For people: ``"C3D (DEC, integer)"``."""
    return f"C3D ({PROCESSORS[file.processor]}, {'real' if layout.real else 'integer'})"


def raw_frames(file: C3DFile, layout: Layout, part: slice) -> tuple[FloatArray, FloatArray]:
    """Some frames, as they are stored.

    Returns
    -------
    points : (F, points, 4) array
        x, y, z in file units and the residual word.
    analog : (F, per_frame, channels) array
        Unscaled.

    Raises
    ------
    RecordingError
        The file has become shorter meanwhile.
    """
    count, size = part.stop - part.start, layout.frame_bytes
    raw = file.stored(layout.start + part.start * size, layout.start + part.stop * size)
    if layout.real:
        values = floats(raw, file.processor)
    else:
        values = np.frombuffer(raw, endian(file.processor) + "i2").astype(np.float64)
    rows = values.reshape(count, -1)
    points = rows[:, : 4 * layout.points].reshape(count, layout.points, 4)
    analog = rows[:, 4 * layout.points :].reshape(count, layout.per_frame, layout.channels)
    if not layout.real:
        points[..., :3] *= layout.scale
        if unsigned(file):
            analog = analog % (1 << 16)
    return points, analog


def unsigned(file: C3DFile) -> bool:
    """Whether ANALOG:FORMAT says that counts and offsets have no sign."""
    return file.text("ANALOG:FORMAT").upper().startswith("UNSIGNED")


def _scale_and_rate(file: C3DFile, oddities: list[str]) -> tuple[float, float]:
    scale = _scalar(file, "POINT:SCALE", file.header.scale, oddities)
    rate = _scalar(file, "POINT:RATE", file.header.rate, oddities)
    if not (np.isfinite(scale) and scale != 0.0):
        raise RecordingError(
            f"{file.path}: POINT:SCALE is {scale}, expected a number other than 0; the file is corrupt"
        )
    if not (np.isfinite(rate) and 0.1 <= rate <= 1e5):
        raise RecordingError(
            f"{file.path}: the frame rate is {rate} Hz, expected 0.1 to 100,000; export the file with its rate"
        )
    return scale, rate


def _scalar(file: C3DFile, name: str, header: float, oddities: list[str]) -> float:
    value = file.numbers(name)
    if value is None:
        return header
    declared = float(value.ravel()[0])
    if np.isfinite(header) and abs(declared - header) > 1e-3 * abs(declared):
        oddities.append(f"{name} is {declared:g}, the header says {header:g}: the parameter was taken")
    return declared


def _data_start(file: C3DFile, oddities: list[str]) -> int:
    """Byte offset of the data; the header's block holds where it is given."""
    declared = (file.words("POINT:DATA_START") or [0])[0]
    block = file.header.data_block or declared
    if declared and file.header.data_block and declared != file.header.data_block:
        oddities.append(
            f"POINT:DATA_START is {declared}, the header says {file.header.data_block}: the header was taken"
        )
    start = (block - 1) * BLOCK
    if not 0 < start < file.size:
        raise RecordingError(
            f"{file.path}: the data should start at byte {start} of a file of {file.size} bytes; "
            "the file is truncated or corrupt, export it again"
        )
    return start


def _counts(file: C3DFile, word: int, available: int, oddities: list[str]) -> tuple[int, int, int]:
    """Points, analog words a frame and frames: the declared combination that fits the file's size."""
    points, words, frames = _declared_points(file), _declared_words(file), _declared_frames(file)
    candidates = list(itertools.product(dict.fromkeys(points), dict.fromkeys(words), dict.fromkeys(frames)))
    candidates = [c for c in candidates if c[2] > 0 and 4 * c[0] + c[1] > 0]
    if not candidates:
        raise RecordingError(f"{file.path}: the file declares no frames or no data; export the trial again")
    surplus = {c: available - c[2] * (4 * c[0] + c[1]) * word for c in candidates}
    fitting = [c for c in candidates if 0 <= surplus[c] < _PADDING]
    if not fitting and _SATURATED in frames:
        fitting = _uncounted(file, word, available, candidates, oddities)
        frames += [c[2] for c in fitting]
    if not fitting and len(candidates) == 1 and surplus[candidates[0]] >= 0:
        oddities.append(f"{surplus[candidates[0]]} bytes follow the last declared frame and were not read")
        fitting = candidates
    if not fitting:
        raise _misfit(file, word, available, candidates)
    votes = Counter(points), Counter(words), Counter(frames)
    best = max(fitting, key=lambda c: sum(vote[part] for vote, part in zip(votes, c, strict=True)))
    for name, declared, taken in zip(
        ("points", "analog words a frame", "frames"), (points, words, frames), best, strict=True
    ):
        others = sorted(set(declared) - {taken} - ({_SATURATED} if name == "frames" else set()))
        if others:
            oddities.append(f"it declares {taken} and {', '.join(map(str, others))} {name}: {taken} fits its size")
    return best


def _look_at_the_end(file: C3DFile, start: int, size: int, frames: int, oddities: list[str]) -> None:
    """Whether the frames before and after the declared end look like frames, as far as the size leaves that open."""

    def frame(index: int) -> bytes:
        return file.stored(start + index * size, start + (index + 1) * size)

    blank = 0
    while blank < frames and _is_blank(frame(frames - blank - 1)):
        blank += 1
    if 0 < blank < frames:
        oddities.append(
            f"the last {blank} of {frames} frames hold hardly anything but zeros: the recording may end before them"
        )
    more = 0
    while start + (frames + more + 1) * size <= file.size and any(frame(frames + more)):
        more += 1
    if more and not any("follow the last declared frame" in oddity for oddity in oddities):
        oddities.append(
            f"what follows the last of {frames} declared frames is not empty and has room for {more} more: not read"
        )


def _is_blank(frame: bytes) -> bool:
    """Whether a frame looks like padding; where no marker is seen, every eighth byte of a frame is not 0."""
    return frame.count(0) >= 0.95 * len(frame)


def _uncounted(
    file: C3DFile, word: int, available: int, candidates: Iterable[tuple[int, int, int]], oddities: list[str]
) -> list[tuple[int, int, int]]:
    """Frames of a file whose counters stop at 65,535: as many as it holds, less the padding of its last block."""
    points, words, _ = next(c for c in candidates if c[2] == _SATURATED)
    frame = (4 * points + words) * word
    held = available // frame
    start = file.size - available
    while held > _SATURATED and not any(file.stored(start + (held - 1) * frame, start + held * frame)):
        held -= 1
    if held <= _SATURATED:
        return []
    oddities.append(f"the file counts up to 65535 frames but holds {held}: all were read")
    return [(points, words, held)]


def _misfit(file: C3DFile, word: int, available: int, candidates: Iterable[tuple[int, int, int]]) -> RecordingError:
    points, words, frames = min(candidates, key=lambda c: c[2] * (4 * c[0] + c[1]))
    frame = (4 * points + words) * word
    held = available // frame
    if held < frames:
        return RecordingError(
            f"{file.path}: truncated: the header promises {frames} frames of {frame} bytes, the file holds {held}; "
            "copy or export it again"
        )
    return RecordingError(
        f"{file.path}: the file contradicts itself: none of its declared numbers of points, channels and frames fits "
        f"its size of {file.size} bytes; export it again"
    )


def _declared_points(file: C3DFile) -> list[int]:
    return [*(file.words("POINT:USED") or [])[:1], file.header.points]


def _declared_words(file: C3DFile) -> list[int]:
    """Analog words a frame, as the header and the parameters have it."""
    used = (file.words("ANALOG:USED") or [])[:1]
    return [file.header.analog_words, *(channels * file.header.analog_per_frame for channels in used)]


def _declared_frames(file: C3DFile) -> list[int]:
    header = file.header
    declared = [header.last - header.first + 1]
    first, last = frame_field(file, "TRIAL:ACTUAL_START_FIELD"), frame_field(file, "TRIAL:ACTUAL_END_FIELD")
    if first is not None and last is not None:
        declared.append(last - first + 1)
    for name in ("POINT:FRAMES", "POINT:LONG_FRAMES"):
        declared += (file.words(name) or [])[:1]
    return declared


def frame_field(file: C3DFile, name: str) -> int | None:
    """TRIAL:ACTUAL_START_FIELD and its like: a frame number in two 16-bit words, the low one first."""
    words = file.words(name)
    if not words:
        return None
    return words[0] + 65536 * words[1] if len(words) > 1 and max(words) < 65536 else words[0]


def _first_frame(file: C3DFile, frames: int, oddities: list[str]) -> int:
    header, trial = file.header.first, frame_field(file, "TRIAL:ACTUAL_START_FIELD")
    if trial is None or trial == header:
        return header
    last = frame_field(file, "TRIAL:ACTUAL_END_FIELD")
    taken = trial if last is not None and last - trial + 1 == frames else header
    if header != _SATURATED and trial % 65536 != header:
        oddities.append(
            f"the header starts at frame {header}, TRIAL:ACTUAL_START_FIELD at {trial}: {taken} fits the frames"
        )
    return taken


def _channels(file: C3DFile, words: int, rate: float, oddities: list[str]) -> tuple[int, int]:
    """Analog channels and samples a frame out of the words a frame."""
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
            f"{file.path}: {words} analog numbers a frame are no multiple of {used} channels (ANALOG:USED) nor of "
            f"{per_frame} samples a frame (header); the file contradicts itself, export it again"
        )
    declared = file.numbers("ANALOG:RATE")
    if declared is not None and abs(float(declared.ravel()[0]) - per_frame * rate) > 1e-3 * per_frame * rate:
        oddities.append(
            f"ANALOG:RATE is {float(declared.ravel()[0]):g} Hz, but {per_frame} samples a frame at {rate:g} Hz make "
            f"{per_frame * rate:g} Hz: the stored samples were taken as they lie"
        )
    return used, per_frame
