"""Anatomical frames of the upper limb from landmarks (ISB: Wu 2005), with their uncertainty.

All frames are defined for a right arm: X forward, Y up along the segment, Z to the right. The landmarks of a left arm
are mirrored first (:func:`mirror_points`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import RecordingError

PALPATION = 0.005
"""Standard deviation of a palpated landmark along each axis, m."""

_MIRROR = np.array([1.0, 1.0, -1.0])


@dataclass(frozen=True)
class FrameDefinition:
    """Definition of an anatomical frame by weighted sums of landmarks."""

    origin: Mapping[str, float]  # weights of landmarks in the origin
    up: Mapping[str, float]  # weights in the vector along +Y
    across: Mapping[str, float]  # weights in a second vector, whose part normal to Y is the third axis
    third: Literal["x", "z"]  # name of this third axis

    @property
    def landmarks(self) -> tuple[str, ...]:
        """Landmarks that define the frame."""
        return tuple(dict.fromkeys((*self.origin, *self.up, *self.across)))


_ELBOW = {"EL": 0.5, "EM": 0.5}
_WRIST = {"RS": 0.5, "US": 0.5}

THORAX = FrameDefinition({"IJ": 1.0}, {"IJ": 0.5, "C7": 0.5, "PX": -0.5, "T8": -0.5}, {"IJ": 1.0, "C7": -1.0}, "x")
UPPER_ARM = FrameDefinition({"GH": 1.0}, {"GH": 1.0, "EL": -0.5, "EM": -0.5}, {"EL": 1.0, "EM": -1.0}, "z")
UPPER_ARM_2 = FrameDefinition(
    {"GH": 1.0}, {"GH": 1.0, "EL": -0.5, "EM": -0.5}, {"US": 1.0, "EL": -0.5, "EM": -0.5}, "x"
)
"""Option 2 of the ISB, for landmarks in a pose with a bent elbow."""
FOREARM = FrameDefinition(_ELBOW, {"EL": 0.5, "EM": 0.5, "US": -1.0}, {"RS": 1.0, "US": -1.0}, "z")
HAND = FrameDefinition(_WRIST, {"RS": 0.5, "US": 0.5, "MCP2": -0.5, "MCP5": -0.5}, {"MCP2": 1.0, "MCP5": -1.0}, "z")
"""Frame of the hand from its landmarks. Without them, see :func:`build_straight_hand`."""

DEFINITIONS = {"thorax": THORAX, "upper_arm": UPPER_ARM, "forearm": FOREARM, "hand": HAND}


@dataclass(frozen=True)
class SegmentFrame:
    """Anatomical frame, constant or for every sample.

    If a landmark is displaced by d (m, in the axes of the landmarks), the frame rotates by the vector J d (rad, in its
    own axes). The matrices J are the sensitivities.
    """

    origin: FloatArray  # (..., 3) m
    rotation: FloatArray  # (..., 3, 3) frame to the axes of the landmarks
    sensitivity: dict[str, FloatArray]  # landmark to its matrix J, (..., 3, 3)


def mirror_points(points: FloatArray) -> FloatArray:
    """Return points (..., 3) of the trial's frame (y up), mirrored from z to -z.

    A left arm becomes a right one, so frames and angles have the same definitions on both sides. In the mirror image, a
    rotation R is S R S with S = diag(1, 1, -1), and an angular velocity (x, y, z) is (-x, -y, z).
    """
    return np.asarray(points * _MIRROR)


def build_frame(definition: FrameDefinition, points: Mapping[str, FloatArray]) -> SegmentFrame:
    """Build an anatomical frame from the positions (..., 3) of landmarks, m.

    The positions of a left arm must be mirrored first (:func:`mirror_points`).

    Raises
    ------
    RecordingError
        A landmark is missing, or the landmarks lie on one line.

    Examples
    --------
    >>> at = {"US": [0, 0, 0], "RS": [0, 0, 0.05], "EL": [0, 0.2, 0.03], "EM": [0, 0.2, -0.03]}
    >>> build_frame(FOREARM, {k: np.array(v, dtype=float) for k, v in at.items()}).rotation.tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    missing = [name for name in definition.landmarks if name not in points]
    if missing:
        raise RecordingError(f"the landmarks {', '.join(missing)} are missing; name them under `landmarks:`")
    up, across = _sum_weighted(definition.up, points), _sum_weighted(definition.across, points)
    length = np.linalg.norm(up, axis=-1)
    y = up / np.where(length > 0, length, np.nan)[..., None]
    lean = np.einsum("...i,...i->...", across, y)
    normal = across - lean[..., None] * y
    reach = np.linalg.norm(normal, axis=-1)
    if np.any(reach < 0.01) or np.any(length < 0.01):
        raise RecordingError(f"the landmarks {', '.join(definition.landmarks)} lie on one line; check their names")
    third = normal / reach[..., None]
    x, z = (third, np.cross(third, y)) if definition.third == "x" else (np.cross(y, third), third)
    rotation = np.stack([x, y, z], axis=-1)
    turn_up, turn_across = _differentiate_rotation(x, z, length=length, lean=lean, reach=reach, third=definition.third)
    sensitivity = {
        name: definition.up.get(name, 0.0) * turn_up + definition.across.get(name, 0.0) * turn_across
        for name in dict.fromkeys((*definition.up, *definition.across))
    }
    return SegmentFrame(_sum_weighted(definition.origin, points), rotation, sensitivity)


def build_straight_hand(forearm: SegmentFrame, points: Mapping[str, FloatArray]) -> SegmentFrame:
    """Return the frame of a hand that is straight in the landmarks' pose.

    The frame has the axes of the forearm's frame, and its origin is the middle of the wrist. The angles of the wrist
    are therefore zero in this pose.
    """
    return SegmentFrame(_sum_weighted(_WRIST, points), forearm.rotation, forearm.sensitivity)


def has_bent_elbow(points: Mapping[str, FloatArray]) -> BoolArray:
    """Return whether the elbow is bent by 60 to 120°, (...); otherwise, option 2 of the upper arm is poorly defined."""
    upper, lower = _sum_weighted(UPPER_ARM.up, points), _sum_weighted(FOREARM.up, points)
    cosine = np.einsum("...i,...i->...", upper, lower)
    size = np.linalg.norm(upper, axis=-1) * np.linalg.norm(lower, axis=-1)
    return np.asarray(np.abs(cosine) <= 0.5 * size)


def frame_covariance(
    frames: tuple[SegmentFrame, ...], covariances: Mapping[str, FloatArray | float] | None = None
) -> FloatArray:
    """Return the common covariance (..., 3 n, 3 n), rad², of the orientation errors of n frames that share landmarks.

    The errors are the rotation vectors of the frames, each in its own axes. ``covariances`` contains covariances (3, 3)
    of landmarks, m², in axes that all frames share, or their standard deviations along each axis, m. Other landmarks
    have the standard deviation :data:`PALPATION`.
    """
    known = covariances or {}
    names = dict.fromkeys(name for frame in frames for name in frame.sensitivity)
    total: FloatArray | None = None
    for name in names:
        spread = np.asarray(known.get(name, PALPATION), dtype=np.float64)
        spread = spread**2 * np.eye(3) if spread.ndim == 0 else spread
        zero = np.zeros_like(frames[0].rotation)
        turn = np.concatenate([frame.sensitivity.get(name, zero) for frame in frames], axis=-2)
        part = turn @ spread @ np.swapaxes(turn, -1, -2)
        total = part if total is None else total + part
    return np.zeros((3 * len(frames),) * 2) if total is None else total


def _sum_weighted(weights: Mapping[str, float], points: Mapping[str, FloatArray]) -> FloatArray:
    """Return a weighted sum of landmark positions."""
    total: FloatArray = np.asarray(sum(w * np.asarray(points[name], dtype=np.float64) for name, w in weights.items()))
    return total


def _differentiate_rotation(
    x: FloatArray, z: FloatArray, *, length: FloatArray, lean: FloatArray, reach: FloatArray, third: Literal["x", "z"]
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives (..., 3, 3) of the frame's rotation vector with respect to ``up`` and ``across``.

    A rotation vector r moves Y by r × Y, hence r_x = Z · dY and r_z = -X · dY. The rotation about Y follows from the
    third axis, which ``across`` and the rotated Y define.
    """
    along_x, along_z = z / length[..., None], -x / length[..., None]
    zero = np.zeros_like(x)
    if third == "z":
        about_y_up, about_y_across = (lean / reach)[..., None] * along_z, x / reach[..., None]
    else:
        about_y_up, about_y_across = (lean / reach)[..., None] * along_x, -z / reach[..., None]
    return np.stack([along_x, about_y_up, along_z], axis=-2), np.stack([zero, about_y_across, zero], axis=-2)
