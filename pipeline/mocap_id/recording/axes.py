"""Names of axes, and the rotation that brings the upward axis of a file to Z."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError

AXES = ("X", "Y", "Z")


def parse_axis(text: str) -> str | None:
    """Return an axis name in capitals and without plus, such as ``"Z"`` or ``"-Y"``; None if it is not an axis."""
    name = text.strip().strip("\x00").upper()
    sign = "-" if name.startswith("-") else ""
    name = name.lstrip("+-").strip()
    return sign + name if name in AXES else None


def check_axis(vertical: str) -> str:
    """Return the axis name of the user's setting ``vertical``; raise ConfigError if it is not an axis."""
    axis = parse_axis(vertical)
    if axis is None:
        raise ConfigError(f"vertical: {vertical!r} is not an axis; expected X, Y or Z, with a minus if it points down")
    return axis


def choose_vertical(force: FloatArray | None, configured: str | None, assumed: str, oddities: list[str]) -> str:
    """Return the upward axis of a file that declares none: ``configured``, or along the ground force, or ``assumed``.

    ``configured`` is the user's setting and has priority. ``force`` (3,) is the mean ground force in the axes of the
    file; it is None if there are no plates. A note is added to ``oddities`` if the axis is assumed or contradicts the
    force.
    """
    axis = None if force is None or not np.any(force) else nearest_axis(force, 0.9)
    along = None if axis is None else axis.lstrip("-")
    if configured is not None:
        if along not in (None, configured.lstrip("-")):
            oddities.append(
                f"the ground force acts along {along}, the configuration says {configured} is up: {configured} was used"
            )
        return configured
    if along is None:
        oddities.append(
            f"the file does not say which axis is up: {assumed} was assumed, as is usual for its format (if it is "
            "another, set `vertical:`)"
        )
    return along or assumed


def axis_vector(axis: str) -> FloatArray:
    """Return the unit vector (3,) of an axis name such as ``"-Y"``, in the axes of the file."""
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
    """Return the rotation (3, 3) from the file's axes to the axes of the lab, where Z is up.

    The first horizontal axis of the file becomes the lab's X (X for files with Z or Y up, Y for files with X up).
    """
    return np.array(_TO_Z_UP[axis], dtype=np.float64)


def nearest_axis(vector: FloatArray, least_cosine: float = 0.95) -> str | None:
    """Return the name of the axis, with its sign, that is nearly parallel to a vector (3,); None if no axis is.

    ``least_cosine`` is the cosine of the largest accepted angle between the vector and the axis.
    """
    length = float(np.linalg.norm(vector))
    if not np.isfinite(length) or length == 0.0:
        return None
    unit = vector / length
    index = int(np.argmax(np.abs(unit)))
    if abs(unit[index]) < least_cosine:
        return None
    return ("-" if unit[index] < 0 else "") + AXES[index]
