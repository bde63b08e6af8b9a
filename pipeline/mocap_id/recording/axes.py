"""Which axis of a file points up, and the turn that takes it to Z."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray

AXES = ("X", "Y", "Z")


def parse_axis(text: str) -> str | None:
    """``"+Z"``, ``"y"``, ``"-Y"`` … as ``"Z"``, ``"Y"``, ``"-Y"``; None where it is no axis."""
    name = text.strip().strip("\x00").upper()
    sign = "-" if name.startswith("-") else ""
    name = name.lstrip("+-").strip()
    return sign + name if name in AXES else None


def axis_vector(axis: str) -> FloatArray:
    """Unit vector of an axis name in the file's own frame, (3,)."""
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
    """Rotation (3, 3) from the file's axes to the lab's: the file's up becomes Z.

    The first horizontal axis of the file stays the lab's X (X for files with Z or Y up; Y for files with X up).
    """
    return np.array(_TO_Z_UP[axis], dtype=np.float64)


def nearest_axis(vector: FloatArray, least_cosine: float = 0.95) -> str | None:
    """The axis that a vector runs along, with its sign; None where it runs along none of them.

    Parameters
    ----------
    vector : (3,) array
        Any length but zero.
    least_cosine : float
        Cosine of the largest accepted angle between the two.
    """
    length = float(np.linalg.norm(vector))
    if not np.isfinite(length) or length == 0.0:
        return None
    unit = vector / length
    index = int(np.argmax(np.abs(unit)))
    if abs(unit[index]) < least_cosine:
        return None
    return ("-" if unit[index] < 0 else "") + AXES[index]
