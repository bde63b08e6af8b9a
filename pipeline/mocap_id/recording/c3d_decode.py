"""C3D data → positions and counts: decoded from the bytes, a stretch of frames after the other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.recording.c3d_file import C3DFile
from mocap_id.recording.c3d_layout import Layout, raw_frames, unsigned

_STRETCH = 1 << 20
"""Bytes of the file that are decoded at once."""


def decode(
    file: C3DFile, layout: Layout, keep: Sequence[int], channels: Sequence[int], metres: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """Decode all frames of some trajectories and analog channels.

    Parameters
    ----------
    keep, channels : sequence of int
        Columns of the file, from 0.
    metres : float
        What positions are multiplied by.

    Returns
    -------
    positions : (frames, keep, 3) array
        NaN where the residual says that the point was not seen.
    counts : (frames * per_frame, channels) array
        As stored, without offset and scale.
    """
    positions = np.empty((layout.frames, len(keep), 3))
    counts = np.empty((layout.frames, layout.per_frame, len(channels)))
    kept = slice(None) if len(keep) == layout.points else list(keep)
    step = max(1, _STRETCH // layout.frame_bytes)
    for first in range(0, layout.frames, step):
        part = slice(first, min(first + step, layout.frames))
        points, analog = raw_frames(file, layout, part)
        np.multiply(points[:, kept, :3], metres, out=positions[part])
        positions[part][~(points[:, kept, 3] >= 0)] = np.nan
        counts[part] = analog[:, :, list(channels)]
    return positions, counts.reshape(layout.frames * layout.per_frame, len(channels))


def calibration(file: C3DFile, layout: Layout) -> tuple[FloatArray, FloatArray]:
    """ANALOG:OFFSET and SCALE of every channel, (channels,): counts → units by ``(count - offset) * scale``.

    ANALOG:GEN_SCALE is included; the scale of a channel is NaN where the file does not give it; offsets of an UNSIGNED
    file have no sign.
    """
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
    return offset, scale * gain
