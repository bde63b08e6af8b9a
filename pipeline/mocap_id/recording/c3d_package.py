"""What the ``c3d`` package reads otherwise in a C3D file: for whoever goes on with it in Python."""

from __future__ import annotations

import itertools
import warnings
from pathlib import Path
from typing import Any

import c3d
import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.recording.c3d_decode import calibration
from mocap_id.recording.c3d_file import C3DFile, open_c3d
from mocap_id.recording.c3d_layout import Layout, establish, raw_frames
from mocap_id.recording.tables import opened

_FRAMES = 100
"""Frames that are compared: a wrong place or stride shows at once."""


def package_differences(path: Path) -> list[str]:
    """One sentence for everything that the ``c3d`` package finds otherwise in a file, in its first 100 frames.

    Raises
    ------
    RecordingError
        The file cannot be read at all.
    """
    with opened(path) as stream:
        file = open_c3d(path, stream)
        layout = establish(file)
        stream.seek(0)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                reader: Any = c3d.Reader(stream)
                counted = reader.point_used, reader.analog_used, reader.last_frame - reader.first_frame + 1
                frames = list(itertools.islice(reader.read_frames(), min(_FRAMES, layout.frames)))
        except Exception as error:  # noqa: BLE001  it raises whatever its code meets
            said = " ".join(str(error).split())[:120] or type(error).__name__
            return [f"the c3d package does not read this file ({said})"]
        here = layout.points, layout.channels, layout.frames
        found = [
            f"the c3d package counts {theirs} {what}, the file holds {ours}"
            for what, theirs, ours in zip(("points", "analog channels", "frames"), counted, here, strict=True)
            if theirs != ours
        ]
        return found or _other_values(file, layout, frames)


def _other_values(file: C3DFile, layout: Layout, frames: list[tuple[int, FloatArray, FloatArray]]) -> list[str]:
    """What differs within the package's frames: number, points (P, 5), analog (channels, per frame)."""
    if not frames:
        return ["the c3d package reads no frame of this file"]
    found = []
    points, counts = raw_frames(file, layout, slice(0, len(frames)))
    theirs = np.array([each for _, each, _ in frames])
    seen, seen_there = points[..., 3] >= 0, theirs[..., 3] >= 0
    both = seen & seen_there & np.isfinite(points).all(axis=2)
    if missing := int((seen & ~seen_there).sum()):
        found.append(f"the c3d package takes {missing} samples of the first {len(frames)} frames for missing")
    if not np.allclose(theirs[both, :3], points[both, :3], rtol=1e-4, atol=1e-3):
        found.append("the c3d package reads other positions")
    if layout.channels:
        offset, scale = calibration(file, layout)
        ours = (counts.reshape(-1, layout.channels) - offset) * scale
        analog = np.concatenate([each.T for _, _, each in frames])
        near = 1e-4 * float(np.abs(ours[np.isfinite(ours)]).max(initial=0))
        if analog.shape != ours.shape or not np.allclose(analog, ours, rtol=1e-4, atol=near, equal_nan=True):
            found.append("the c3d package reads other analog values")
    return found
