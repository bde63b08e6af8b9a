"""Marker positions and analog counts of a C3D file, decoded from its bytes in blocks of frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.recording.c3d_file import C3DFile
from mocap_id.recording.c3d_layout import Layout, is_unsigned, read_frames

_BLOCK_BYTES = 1 << 20  # bytes of the file to decode at a time


def decode(
    file: C3DFile, layout: Layout, keep: Sequence[int], channels: Sequence[int], metres: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """Decode all frames of the trajectories ``keep`` and of the analog ``channels``, both from 0.

    Returns positions (frames, keep, 3), m, with ``metres`` per length unit of the file; NaN if the residual marks the
    point as not seen. Returns also counts (frames * per_frame, channels): analog samples as stored, without offset and
    scale.
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
    is NaN for a channel without a scale.
    """
    general = file.numbers("ANALOG:GEN_SCALE")
    gain = 1.0 if general is None else float(general.ravel()[0])
    offset = np.zeros(layout.channels)
    declared = file.words("ANALOG:OFFSET") if is_unsigned(file) else file.numbers("ANALOG:OFFSET")
    if declared is not None:
        values = np.asarray(declared, dtype=np.float64).ravel()[: layout.channels]
        offset[: len(values)] = values
    scales = file.numbers("ANALOG:SCALE")
    scale = np.full(layout.channels, 1.0 if scales is None else np.nan)
    if scales is not None:
        scale[: scales.size] = scales.ravel()[: layout.channels]
    return offset, scale * gain
