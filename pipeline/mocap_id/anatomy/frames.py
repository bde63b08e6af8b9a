"""Frames of the segments of the upper limb from landmarks (ISB: Wu 2005), with their uncertainty.

All frames are those of a right arm: X forward, Y up along the segment, Z to the right. The landmarks of a left arm are
mirrored first (:func:`mirror_points`).
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
    """The recipe of a frame: weighted sums of landmarks.

    Parameters
    ----------
    origin : mapping
        Landmark to its weight in the origin.
    up : mapping
        Weights of the vector along +Y.
    across : mapping
        Weights of a second vector. Its part normal to Y is the third axis.
    third : {"x", "z"}
        Axis that ``across`` gives.
    """

    origin: Mapping[str, float]
    up: Mapping[str, float]
    across: Mapping[str, float]
    third: Literal["x", "z"]

    @property
    def landmarks(self) -> tuple[str, ...]:
        """Landmarks that the frame needs."""
        return tuple(dict.fromkeys((*self.origin, *self.up, *self.across)))


_ELBOW = {"EL": 0.5, "EM": 0.5}
_WRIST = {"RS": 0.5, "US": 0.5}

THORAX = FrameDefinition({"IJ": 1.0}, {"IJ": 0.5, "C7": 0.5, "PX": -0.5, "T8": -0.5}, {"IJ": 1.0, "C7": -1.0}, "x")
UPPER_ARM = FrameDefinition({"GH": 1.0}, {"GH": 1.0, "EL": -0.5, "EM": -0.5}, {"EL": 1.0, "EM": -1.0}, "z")
UPPER_ARM_2 = FrameDefinition(
    {"GH": 1.0}, {"GH": 1.0, "EL": -0.5, "EM": -0.5}, {"US": 1.0, "EL": -0.5, "EM": -0.5}, "x"
)
"""Option 2 of the ISB, for the landmarks of a pose in which the elbow is bent."""
FOREARM = FrameDefinition(_ELBOW, {"EL": 0.5, "EM": 0.5, "US": -1.0}, {"RS": 1.0, "US": -1.0}, "z")
HAND = FrameDefinition(_WRIST, {"RS": 0.5, "US": 0.5, "MCP2": -0.5, "MCP5": -0.5}, {"MCP2": 1.0, "MCP5": -1.0}, "z")
"""Frame of the hand from its own landmarks. Without them: :func:`build_straight_hand`."""

DEFINITIONS = {"thorax": THORAX, "upper_arm": UPPER_ARM, "forearm": FOREARM, "hand": HAND}


@dataclass(frozen=True)
class SegmentFrame:
    """A frame, or one for every sample.

    Parameters
    ----------
    origin : (..., 3) array
        m.
    rotation : (..., 3, 3) array
        Frame to the axes of the landmarks.
    sensitivity : dict
        Landmark to the (..., 3, 3) array J: if the landmark lies off by d (in the axes of the landmarks, m), the frame
        is turned by the rotation vector J d, in its own axes, rad.
    """

    origin: FloatArray
    rotation: FloatArray
    sensitivity: dict[str, FloatArray]


def mirror_points(points: FloatArray) -> FloatArray:
    """Return points (..., 3) of the trial's frame (y up), mirrored from z to -z.

    A left arm becomes a right one: all frames and angles then mean the same as on the right. A rotation R of the mirror
    image is S R S with S = diag(1, 1, -1), and an angular velocity (x, y, z) becomes (-x, -y, z).
    """
    return np.asarray(points * _MIRROR)


def build_frame(definition: FrameDefinition, points: Mapping[str, FloatArray]) -> SegmentFrame:
    """Build a frame from landmarks.

    Parameters
    ----------
    definition : FrameDefinition
    points : mapping
        Landmark to its (..., 3) position, m. Those of a left arm must be mirrored.

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
    """Return the frame of a straight hand: parallel to the forearm, at the middle of the wrist.

    It is the frame of the hand if the wrist is straight in the pose of the landmarks; the angles of the wrist then
    count from this pose.
    """
    return SegmentFrame(_sum_weighted(_WRIST, points), forearm.rotation, forearm.sensitivity)


def has_bent_elbow(points: Mapping[str, FloatArray]) -> BoolArray:
    """Return where the elbow is bent by 60 to 120°, so that option 2 of the upper arm is well defined."""
    upper, lower = _sum_weighted(UPPER_ARM.up, points), _sum_weighted(FOREARM.up, points)
    cosine = np.einsum("...i,...i->...", upper, lower)
    size = np.linalg.norm(upper, axis=-1) * np.linalg.norm(lower, axis=-1)
    return np.asarray(np.abs(cosine) <= 0.5 * size)


def frame_covariance(
    frames: tuple[SegmentFrame, ...], covariances: Mapping[str, FloatArray | float] | None = None
) -> FloatArray:
    """Return the joint covariance of the orientations of frames that share landmarks.

    Parameters
    ----------
    frames : tuple of SegmentFrame, length n
        Built from landmarks in the same axes.
    covariances : mapping, optional
        Landmark to its (3, 3) covariance in the axes of the landmarks, m², or to its standard deviation along each
        axis, m. Others have the standard deviation :data:`PALPATION`.

    Returns
    -------
    (..., 3 n, 3 n) array
        Covariance of the rotation vectors of the frames, each in its own axes, rad².
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
    total: FloatArray = np.asarray(sum(w * np.asarray(points[name], dtype=np.float64) for name, w in weights.items()))
    return total


def _differentiate_rotation(
    x: FloatArray, z: FloatArray, *, length: FloatArray, lean: FloatArray, reach: FloatArray, third: Literal["x", "z"]
) -> tuple[FloatArray, FloatArray]:
    """Return the rotation vectors (..., 3, 3) in the frame's axes for a change of ``up`` and of ``across``.

    A rotation vector r moves Y by r × Y, hence r_x = Z · dY and r_z = -X · dY. The rotation about Y follows from the
    third axis, which ``across`` and the turned Y give.
    """
    along_x, along_z = z / length[..., None], -x / length[..., None]
    zero = np.zeros_like(x)
    if third == "z":
        about_y_up, about_y_across = (lean / reach)[..., None] * along_z, x / reach[..., None]
    else:
        about_y_up, about_y_across = (lean / reach)[..., None] * along_x, -z / reach[..., None]
    return np.stack([along_x, about_y_up, along_z], axis=-2), np.stack([zero, about_y_across, zero], axis=-2)
