"""Measured poses of marker clusters: each by itself, with no joint between them.

A chain pins its segments to each other. A cluster's own pose shows how its body really moved, gaps at the joints
included. Its frame is that of the chain's segment, so that what is known in one frame holds in the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray, chunks
from mocap_id.kinematics.rigid import fit_body, marker_residuals, rigid_poses
from mocap_id.kinematics.sampling import frames_along_motion

LEAST_MARKERS = 2
"""Fewest markers that give a pose in a frame."""
_FRAMES = 600  # enough to find a cluster's shape
_LEAST_SEEN = 5  # of these; a marker that is seen less has no known place on the body and takes no part
_LEAST_SPREAD = 0.01  # m, rms distance of the markers from their centroid that still shows an angle
_OUTLIER = 5.0  # of a marker's own residual: what is farther off in one frame is left out there
_LEAST_RESIDUAL = 1e-3  # m; markers that fit better than this are not judged more strictly


@dataclass(frozen=True)
class ClusterPose:
    """Pose of one cluster in every frame.

    Parameters
    ----------
    markers : (k,) int array
        The columns of the markers that show the pose.
    local : (k,) complex array
        Their places in the body's frame, m; x + i y.
    position : (F,) complex array
        Centroid of all its markers in the plane frame, m; NaN where fewer than two markers are seen.
    angle : (F,) array
        Angle of the body's frame from the plane frame, rad, without jumps of a full turn; NaN likewise.
    count : (F,) int array
        Markers that each frame rests on.
    residual : float
        rms distance of the markers from their places on the body, m.
    """

    markers: IntArray
    local: ComplexArray
    position: ComplexArray
    angle: FloatArray
    count: IntArray
    residual: float


def measure_cluster(points: ComplexArray, wanted: ComplexArray | None = None) -> ClusterPose | None:
    """Fit a rigid shape to a cluster and its pose to every frame.

    Parameters
    ----------
    points : (F, m) complex array
        Markers in the plane frame, m; NaN where unseen.
    wanted : (m,) complex array, optional
        Where the markers lie in the frame that the body is to have. Without it the frame's origin is the cluster's
        centroid, and the frame is parallel to the plane frame on average.

    Returns
    -------
    ClusterPose or None
        None for fewer than two markers, markers at one place, or markers that are never seen together.
    """
    together = np.flatnonzero(np.isfinite(points).sum(axis=1) >= LEAST_MARKERS)
    if points.shape[1] < LEAST_MARKERS or len(together) < 2:
        return None
    chosen = frames_along_motion(points, _FRAMES, together)
    often = np.isfinite(points[chosen]).sum(axis=0) >= min(_LEAST_SEEN, len(chosen))
    markers = np.flatnonzero(often)
    if len(markers) < LEAST_MARKERS:
        return None
    if not often.all():
        points, wanted = points[:, markers], None if wanted is None else wanted[markers]
    some = points[chosen]
    body = fit_body(some, np.arange(len(markers)))
    if not np.sqrt(np.mean(np.abs(body.template) ** 2)) > _LEAST_SPREAD:
        return None
    own = np.maximum(marker_residuals(body, some), _LEAST_RESIDUAL)
    rotation, position = (np.full(len(points), np.nan, dtype=np.complex128) for _ in range(2))
    count, squares, used = np.zeros(len(points), dtype=np.int64), 0.0, 0
    for part in chunks(len(points)):
        rotation[part], position[part], count[part], off = _poses(points[part], body.template, own)
        squares, used = squares + float(off @ off), used + len(off)
    turn, shift = _frame(body.template, wanted, rotation[count >= LEAST_MARKERS])
    angle = np.full(len(points), np.nan)
    known = count >= LEAST_MARKERS
    angle[known] = np.unwrap(np.angle(rotation[known] / turn))
    return ClusterPose(
        markers=markers,
        local=turn * body.template + shift,
        position=position,
        angle=angle,
        count=count,
        residual=float(np.sqrt(squares / used)),
    )


def _poses(
    points: ComplexArray, template: ComplexArray, own: FloatArray
) -> tuple[ComplexArray, ComplexArray, IntArray, FloatArray]:
    """Rotation, position (f,; NaN where unknown), markers used (f,), and distances of those from their places, m."""
    seen = np.isfinite(points)
    rotation, position, off = _placed(points, seen, template)
    while True:
        far = np.any(seen & (off > _OUTLIER * own), axis=1) & (seen.sum(axis=1) > LEAST_MARKERS + 1)
        rows = np.flatnonzero(far)
        if not len(rows):
            break
        seen[rows, _worst(points[rows], seen[rows], template)] = False
        rotation[rows], position[rows], off[rows] = _placed(points[rows], seen[rows], template)
    count = seen.sum(axis=1)
    known = count >= LEAST_MARKERS
    unknown = np.where(known, 1.0, np.nan)
    return rotation * unknown, position * unknown, count, off[seen & known[:, None]]


def _placed(
    points: ComplexArray, seen: BoolArray, template: ComplexArray
) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Rotation and position (f,), and distances of all markers from their places (f, m), m."""
    z = np.where(seen, points, 0)
    rotation, position = rigid_poses(z, seen, template)
    return rotation, position, np.abs(z - position[:, None] - rotation[:, None] * template)


def _worst(points: ComplexArray, seen: BoolArray, template: ComplexArray) -> IntArray:
    """The marker (f,) without which the others fit best; a marker that jumps bends the fit of all."""
    cost = np.full(seen.shape, np.inf)
    for k in range(seen.shape[1]):
        others = seen.copy()
        others[:, k] = False
        off = _placed(points, others, template)[2]
        cost[:, k] = np.where(seen[:, k], np.sum(np.where(others, off**2, 0), axis=1), np.inf)
    return np.asarray(np.argmin(cost, axis=1))


def _frame(template: ComplexArray, wanted: ComplexArray | None, rotation: ComplexArray) -> tuple[complex, complex]:
    """Turn and shift that take the template into the body's frame."""
    if wanted is None:
        return complex(np.exp(1j * np.angle(rotation.mean()))), 0j
    known = np.isfinite(wanted)
    a, b = template[known], wanted[known]
    moment = np.sum((b - b.mean()) * np.conj(a - a.mean()))
    turn = moment / abs(moment)
    return complex(turn), complex(b.mean() - turn * a.mean())
