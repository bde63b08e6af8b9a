"""The upward axis of a file, and the rotation that turns it to Z."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray

AXES = ("X", "Y", "Z")


def parse_axis(text: str) -> str | None:
    """Return the axis name of ``"+Z"``, ``"y"`` or ``"-Y"`` as ``"Z"``, ``"Y"`` or ``"-Y"``; None if not an axis."""
    name = text.strip().strip("\x00").upper()
    sign = "-" if name.startswith("-") else ""
    name = name.lstrip("+-").strip()
    return sign + name if name in AXES else None


def axis_vector(axis: str) -> FloatArray:
    """Return the unit vector (3,) of an axis name, in the frame of the file."""
    vector = np.zeros(3)
    vector[AXES.index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    return vector


_TO_Z_UP: dict[str, tuple[tuple[int, int, int], ...]] = {
    "Z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-Z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "Y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-Y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "X": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-X": ((0, 1, 0), (0, 0, -1), (-1, 0, 0)),
}


def to_z_up(axis: str) -> FloatArray:
    """Return the rotation (3, 3) from the file's axes to the lab's, where Z is up.

    The first horizontal axis of the file becomes the lab's X (X for files with Z or Y up, Y for files with X up).
    """
    return np.array(_TO_Z_UP[axis], dtype=np.float64)


def nearest_axis(vector: FloatArray, least_cosine: float = 0.95) -> str | None:
    """Return the signed axis that is nearly parallel to a vector; None if there is none.

    Parameters
    ----------
    vector : (3,) array
        Non-zero vector of any length.
    least_cosine : float
        Cosine of the largest accepted angle between vector and axis.
    """
    length = float(np.linalg.norm(vector))
    if not np.isfinite(length) or length == 0.0:
        return None
    unit = vector / length
    index = int(np.argmax(np.abs(unit)))
    if abs(unit[index]) < least_cosine:
        return None
    return ("-" if unit[index] < 0 else "") + AXES[index]
