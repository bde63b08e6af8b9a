"""Landmarks from pointer trials: the tip of a rod touches the landmark while the cluster of the segment is visible.

The markers of the pointer lie on one line with its tip. The distances from the tip to the markers are measured on the
pointer, or estimated from trials in which the pointer rotates about its resting tip (:func:`calibrate_pointer`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.anatomy.frames import PALPATION
from mocap_id.anatomy.still_pose import LandmarkPosition
from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.verdict import Reason

_SD_TIP = 0.005  # m; largest usable standard deviation of the tip
_BEND = 0.005  # m; largest rms distance of the markers from the rod
_LASTING = 50.0  # frames over which the error of skin and hand is practically constant
_MOVES = 0.005  # m; largest rms motion of the tip in the cluster's frame


@dataclass(frozen=True)
class Pointer:
    """Straight pointer with markers."""

    distances: FloatArray  # (P,) distances from the tip to the markers, m
    sd: float = 0.0  # standard deviation of the tip's position along the rod, m


@dataclass(frozen=True)
class PointedLandmark:
    """Landmark from one pointer trial."""

    position: LandmarkPosition  # position in the frame of the segment's cluster
    rod_residual: float  # rms distance of the pointer's markers from their positions on the rod, m
    reasons: tuple[Reason, ...]  # cautions: the rod does not fit its markers, or the tip moves


def find_pointer_markers(trial: Sequence[str], pointer_trials: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the names of the markers that every pointer trial has and the trial itself does not have.

    Examples
    --------
    >>> find_pointer_markers(["UA1", "UA2"], [["UA1", "UA2", "P1", "P2"], ["P1", "P2", "UA1"]])
    ('P1', 'P2')
    """
    first, *others = pointer_trials
    return tuple(name for name in first if name not in set(trial) and all(name in other for other in others))


def locate_tip(markers: FloatArray, pointer: Pointer) -> tuple[FloatArray, FloatArray]:
    """Return the tip positions and the residuals of a least-squares line through the pointer's markers in each frame.

    The markers (F, P, 3) are in m, NaN where missing. The tip (F, 3), m, is NaN where a marker is missing. The residual
    (F,), m, is the rms distance of the markers from their positions on the rod. A RecordingError is raised unless the
    pointer has one distance for each marker, at least two, and 50 mm between the smallest and the largest.
    """
    distances = np.asarray(pointer.distances, dtype=np.float64)
    if distances.shape != (markers.shape[1],) or len(distances) < 2 or np.ptp(distances) < 0.05:
        raise RecordingError(
            f"the pointer has {markers.shape[1]} markers and {distances.size} distances from its tip; expected one "
            "distance for each marker, at least two, and 50 mm between the nearest and the farthest"
        )
    centred = distances - distances.mean()
    along = np.einsum("p,fpi->fi", centred, markers)
    length = np.linalg.norm(along, axis=1)
    direction = along / np.where(length > 0, length, np.nan)[:, None]
    tip = markers.mean(axis=1) - distances.mean() * direction
    off = markers - tip[:, None] - distances[None, :, None] * direction[:, None]
    return tip, np.sqrt(np.mean(np.sum(off**2, axis=-1), axis=1))


def locate_pointed_landmark(
    markers: FloatArray,
    rotation: FloatArray,
    origin: FloatArray,
    pointer: Pointer,
    palpation: float = PALPATION,
) -> PointedLandmark:
    """Return the landmark of a pointer trial in the frame of the segment's cluster.

    The pointer's markers (F, P, 3) are in m. ``rotation`` (F, 3, 3), cluster to trial, and ``origin`` (F, 3), m, are
    the pose of the cluster. All are NaN where missing. ``palpation`` is the standard deviation of the touched position
    along each axis, m.

    Raises
    ------
    RecordingError
        Pointer and cluster are never visible in the same frame.
    """
    tip, residual = locate_tip(markers, pointer)
    local = np.einsum("fji,fj->fi", rotation, tip - origin)
    seen = np.isfinite(local).all(axis=1)
    if not seen.any():
        raise RecordingError(
            "the pointer and the markers of the landmark's segment are never visible in the same frame"
        )
    mean = np.median(local[seen], axis=0)
    spread = float(np.sqrt(np.mean(np.sum((local[seen] - mean) ** 2, axis=1))))
    bend = float(np.sqrt(np.mean(residual[seen] ** 2)))
    sd = float(np.sqrt(palpation**2 + (spread**2 + bend**2 + pointer.sd**2) / 3))
    reasons: list[Reason] = []
    if bend > _BEND:
        message = (
            f"the pointer's markers are {1000 * bend:.1f} mm rms from their positions on a straight rod, expected "
            f"below {1000 * _BEND:.0f} mm; check the distances in `pointer:` and their order"
        )
        reasons.append(Reason("pointer-bent", message, bend, _BEND))
    if spread > _MOVES:
        message = (
            f"the pointer's tip moves by {1000 * spread:.1f} mm rms in the segment, expected below {1000 * _MOVES:.0f} "
            "mm; shorten the trial to the time in which the tip touches the landmark"
        )
        reasons.append(Reason("pointer-moves", message, spread, _MOVES))
    return PointedLandmark(LandmarkPosition(mean, sd, spread), bend, tuple(reasons))


def calibrate_pointer(trials: Sequence[tuple[FloatArray, FloatArray, FloatArray]]) -> Pointer:
    """Return the pointer, with its distances estimated from trials in which it rotates about its resting tip.

    The tip p is constant in the frame of the cluster: c(t) - l e(t) = p. Here c is the mean of the markers, e the
    direction of the rod, and l the distance from the tip to c. A least-squares fit gives l, and p of each trial. The
    noise of e is estimated from neighbouring frames and subtracted, because it is not a rotation. The standard
    deviation of l assumes errors that persist for about half a second.

    Parameters
    ----------
    trials : sequence of (markers, rotation, origin)
        Arrays as in :func:`locate_pointed_landmark`, with the markers in the same order in every trial.

    Raises
    ------
    RecordingError
        The pointer rotates too little: the standard deviation of the tip is above 5 mm.
    """
    gain, noise, product = 0.0, 0.0, 0.0
    centred, offsets = [], []
    for markers, rotation, origin in trials:
        seen = np.isfinite(markers).all(axis=(1, 2)) & np.isfinite(rotation).all(axis=(1, 2))
        middle = np.einsum("fji,fj->fi", rotation[seen], markers[seen].mean(axis=1) - origin[seen])
        direction, offset = _measure_rod(markers[seen])
        direction = np.einsum("fji,fj->fi", rotation[seen], direction)
        offsets.append(offset)
        middle, direction = middle - middle.mean(axis=0), direction - direction.mean(axis=0)
        gain += float(np.sum(direction**2))
        noise += float(np.mean(np.sum(np.diff(direction, axis=0) ** 2, axis=1)) / 2 * len(direction))
        product += float(np.sum(direction * middle))
        centred.append((middle, direction))
    turn = gain - noise
    length = product / turn if turn > noise else np.nan
    off = np.concatenate([middle - length * direction for middle, direction in centred])
    sd = float(np.sqrt(np.mean(off**2) * _LASTING / turn)) if turn > noise else np.inf
    if not sd < _SD_TIP:
        raise RecordingError(
            f"the pointer rotates too little to locate its tip (± {1000 * sd:.0f} mm along the rod). Give "
            "the distances from the tip to its markers in `pointer:`, or a trial in which it rotates by 45° about its "
            "resting tip"
        )
    offset = np.mean(offsets, axis=0)
    return Pointer(length + offset if length > 0 else -length - offset, sd)


def _measure_rod(markers: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the direction (F, 3) from the last marker to the first, and the markers' positions (P,) along it, m."""
    ends = markers[:, 0] - markers[:, -1]
    direction = ends / np.linalg.norm(ends, axis=1, keepdims=True)
    along = np.einsum("fpi,fi->fp", markers - markers.mean(axis=1, keepdims=True), direction)
    return direction, along.mean(axis=0)
