"""Decoding C3D data with the ``c3d`` package, which is held against the bytes, and from the bytes where it refuses.

No compiled library sees a broken header: ``ezc3d`` reads beyond its memory on some of them, which ends the process.
"""

from __future__ import annotations

import io
import struct
import warnings
from dataclasses import dataclass

import c3d
import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.c3d_file import C3DFile
from mocap_id.recording.c3d_layout import Layout, raw_frame, raw_frames, unsigned

_REFUSALS = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    NameError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""What the library raises on files that it does not take."""


@dataclass(frozen=True)
class Calibration:
    """Analog counts → units: ``(count - offset) * scale``, ANALOG:GEN_SCALE included.

    Parameters
    ----------
    offset, scale : (channels,) array
        ``scale`` is NaN for channels whose scale the file does not give.
    """

    offset: FloatArray
    scale: FloatArray


@dataclass(frozen=True)
class Decoded:
    """The data of a C3D file.

    Parameters
    ----------
    points : (frames, points, 3) array
        File units; NaN where the residual says that the point was not seen.
    analog : (frames * per_frame, channels) array
        In the channels' units.
    oddities : tuple of str
    """

    points: FloatArray
    analog: FloatArray
    oddities: tuple[str, ...]


def decode(file: C3DFile, layout: Layout) -> Decoded:
    """Decode all frames.

    Raises
    ------
    RecordingError
        The file cannot be read as it lies on the disk.
    """
    refusals = []
    for name, decoder in (("c3d", _by_c3d), ("its bytes", _by_bytes)):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what they warn of, the layout has settled
                points, analog = decoder(file, layout)
        except struct.error as error:
            raise RecordingError(
                f"{file.path}: no library reads this C3D file (c3d: {error}): its parameters lead out of their "
                "section; it is corrupt, export it again"
            ) from error
        except _REFUSALS as error:
            refusals.append(f"{name}: {' '.join(str(error).split())[:120] or type(error).__name__}")
            continue
        if fault := _fault(file, layout, points):
            refusals.append(f"{name}: {fault}")
            continue
        oddities = [f"read by {name}, since {refusal}" for refusal in refusals]
        if fault := _analog_fault(file, layout, analog):
            analog, oddities = np.full_like(analog, np.nan), [*oddities, f"analog channels left out: {name}: {fault}"]
        return Decoded(points, analog, tuple(oddities))
    raise RecordingError(
        f"{file.path}: this C3D file cannot be decoded ({'; '.join(refusals)}); it is corrupt or not of the standard, "
        "export it again"
    )


def calibration(file: C3DFile, layout: Layout) -> Calibration:
    """ANALOG:OFFSET, SCALE and GEN_SCALE of every channel; offsets of an UNSIGNED file have no sign."""
    general = file.numbers("ANALOG:GEN_SCALE")
    gain = 1.0 if general is None else float(general.ravel()[0])
    offset = np.zeros(layout.channels)
    declared = file.words("ANALOG:OFFSET") if unsigned(file) else file.numbers("ANALOG:OFFSET")
    if declared is not None:
        values = np.asarray(declared, dtype=np.float64).ravel()[: layout.channels]
        offset[: len(values)] = values
    scales = file.numbers("ANALOG:SCALE")
    scale = np.full(layout.channels, 1.0 if scales is None else np.nan)
    if scales is not None:
        scale[: scales.size] = scales.ravel()[: layout.channels]
    return Calibration(offset, scale * gain)


class _C3DReader(c3d.Reader):  # type: ignore[misc]
    """The package's decoder, with the counts that were settled against the file's size.

    On its own it takes ``POINT:FRAMES`` for the last frame's number and multiplies the high word of a start frame by
    65535.
    """

    def __init__(self, handle: io.BytesIO, layout: Layout) -> None:
        self.layout = layout
        super().__init__(handle)

    def _check_metadata(self) -> None:
        """Done by the layout."""

    first_frame = property(lambda self: 0)
    last_frame = property(lambda self: self.layout.frames - 1)
    point_used = property(lambda self: self.layout.points)
    point_scale = property(lambda self: self.layout.scale)
    analog_used = property(lambda self: self.layout.channels)
    analog_per_frame = property(lambda self: self.layout.per_frame)

    def get_analog_transform(self) -> tuple[float, float]:
        """Counts stay counts: ours is applied afterwards."""
        return 1.0, 0.0


def _by_c3d(file: C3DFile, layout: Layout) -> tuple[FloatArray, FloatArray]:
    reader = _C3DReader(io.BytesIO(file.data), layout)
    points = np.full((layout.frames, layout.points, 3), np.nan)
    counts = np.empty((layout.frames, layout.per_frame, layout.channels))
    read = 0
    for index, samples, analog in reader.read_frames(copy=False):
        seen = samples[:, 3] >= 0
        points[index, seen] = samples[seen, :3]
        if layout.channels:
            counts[index] = analog.T
        read += 1
    if read != layout.frames:
        raise ValueError(f"{read} of {layout.frames} frames read")
    if layout.points and np.isnan(points).all():
        raise ValueError("every sample has a residual that marks it as missing")
    if not layout.channels:
        return points, np.empty((0, 0))
    use = calibration(file, layout)
    return points, (counts.reshape(-1, layout.channels) - use.offset) * use.scale


def _by_bytes(file: C3DFile, layout: Layout) -> tuple[FloatArray, FloatArray]:
    stored, counts = raw_frames(file, layout, slice(0, layout.frames))
    points = np.where(stored[..., 3:] < 0, np.nan, stored[..., :3])
    if not layout.channels:
        return points, np.empty((0, 0))
    use = calibration(file, layout)
    return points, (counts.reshape(-1, layout.channels) - use.offset) * use.scale


def _checked_frames(layout: Layout) -> list[int]:
    return sorted({0, layout.frames // 3, layout.frames // 2, layout.frames - 1})


def _fault(file: C3DFile, layout: Layout, points: FloatArray) -> str:
    """What is wrong with decoded points, held against the bytes of some frames; empty where nothing is."""
    for index in _checked_frames(layout):
        stored = raw_frame(file, layout, index)[0][:, :3]
        seen = np.isfinite(points[index]).all(axis=1)
        if not np.allclose(points[index][seen], stored[seen], rtol=1e-4, atol=1e-3):
            return f"frame {index} is decoded otherwise than it is stored"
    return ""


def _analog_fault(file: C3DFile, layout: Layout, analog: FloatArray) -> str:
    """The same for the analog channels."""
    if not layout.channels:
        return ""
    use = calibration(file, layout)
    for index in _checked_frames(layout):
        stored = (raw_frame(file, layout, index)[1] - use.offset) * use.scale
        decoded = analog[index * layout.per_frame : (index + 1) * layout.per_frame]
        span = np.abs(stored[np.isfinite(stored)]).max(initial=1e-9)
        if not np.allclose(decoded, stored, rtol=1e-4, atol=1e-4 * span, equal_nan=True):
            return f"the analog samples of frame {index} are decoded otherwise than they are stored"
    return ""
