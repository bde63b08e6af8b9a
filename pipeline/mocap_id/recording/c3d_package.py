"""Differences between this reader of C3D files and the ``c3d`` package."""

from __future__ import annotations

import itertools
import warnings
from pathlib import Path
from typing import Any

import c3d
import numpy as np

from mocap_id.recording.c3d_file import C3DFile
from mocap_id.recording.text_tables import open_recording

_FRAMES = 100  # number of frames to compare; this is enough, because a wrong position or stride affects every frame


def compare_with_package(path: Path) -> list[str]:
    """Return a sentence about each value that the ``c3d`` package reads differently in the first 100 frames."""
    with open_recording(path) as stream:
        file = C3DFile(path, stream)
        stream.seek(0)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                reader: Any = c3d.Reader(stream)
                counted = reader.point_used, reader.analog_used, reader.last_frame - reader.first_frame + 1
                frames = list(itertools.islice(reader.read_frames(), min(_FRAMES, file.frames)))
        except Exception as error:  # noqa: BLE001  the package raises many kinds
            said = " ".join(str(error).split())[:120] or type(error).__name__
            return [
                f"the c3d package, which serves only as a comparison here, cannot read this file ({said}): its content "
                "was read without that package, and you need to do nothing"
            ]
        ours = file.points, file.channels, file.frames
        differences = [
            f"the c3d package counts {theirs} {what}, the file contains {own}"
            for what, theirs, own in zip(("points", "analog channels", "frames"), counted, ours, strict=True)
            if theirs != own
        ]
        if differences:
            return differences
        if not frames:
            return ["the c3d package reads no frames of this file"]
        points, counts = file.read_frames(slice(0, len(frames)))
        theirs = np.array([each for _, each, _ in frames])
        visible, visible_by_package = points[..., 3] >= 0, theirs[..., 3] >= 0
        both = visible & visible_by_package & np.isfinite(points).all(axis=2)
        if missing := int((visible & ~visible_by_package).sum()):
            differences.append(
                f"the c3d package treats {missing} measured samples of the first {len(frames)} frames as missing"
            )
        if not np.allclose(theirs[both, :3], points[both, :3], rtol=1e-4, atol=1e-3):
            differences.append("the c3d package reads different positions")
        if file.channels:
            offset, scale = file.read_channel_scales()
            own = (counts.reshape(-1, file.channels) - offset) * scale
            analog = np.concatenate([each.T for _, _, each in frames])
            near = 1e-4 * float(np.abs(own[np.isfinite(own)]).max(initial=0))
            if analog.shape != own.shape or not np.allclose(analog, own, rtol=1e-4, atol=near, equal_nan=True):
                differences.append("the c3d package reads different analog values")
        return differences
