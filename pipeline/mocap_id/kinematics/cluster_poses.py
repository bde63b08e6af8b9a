"""Measured poses of marker clusters: each by itself, with no joint between them.

A chain pins its segments to each other. A cluster's own pose shows how its body really moved, gaps at the joints
included. Its frame is that of the chain's segment, so that what is known in one frame holds in the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray, chunks
from mocap_id.kinematics.rigid import fit_body, marker_residuals, rigid_poses
from mocap_id.kinematics.sampling import frames_along_motion

_FRAMES = 600  # enough to find a cluster's shape
_LEAST_SPREAD = 0.01  # m, rms distance of the markers from their centroid that still shows an angle
_OUTLIER = 5.0  # of a marker's own residual: what is farther off in one frame is left out there
_LEAST_RESIDUAL = 1e-3  # m; markers that fit better than this are not judged more strictly


@dataclass(frozen=True)
class ClusterPose:
    """Pose of one cluster in every frame.

    Parameters
    ----------
    local : (m,) complex array
        Markers in the body's frame, m; x + i y.
    position : (F,) complex array
        Centroid of all its markers in the plane frame, m; NaN where fewer than two markers are seen.
    angle : (F,) array
        Angle of the body's frame from the plane frame, rad, without jumps of a full turn; NaN likewise.
    count : (F,) int array
        Markers that each frame rests on.
    residual : float
        rms distance of the markers from their places on the body, m.
    """

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
    if points.shape[1] < 2:
        return None
    together = np.flatnonzero(np.isfinite(points).sum(axis=1) >= 2)
    if len(together) < 2:
        return None
    some = points[frames_along_motion(points, _FRAMES, together)]
    body = fit_body(some, np.arange(points.shape[1]))
    if not np.sqrt(np.mean(np.abs(body.template) ** 2)) > _LEAST_SPREAD:
        return None
    own = np.maximum(marker_residuals(body, some), _LEAST_RESIDUAL)
    rotation, position = (np.full(len(points), np.nan, dtype=np.complex128) for _ in range(2))
    count, squares, used = np.zeros(len(points), dtype=np.int64), 0.0, 0
    for part in chunks(len(points)):
        rotation[part], position[part], count[part], off = _poses(points[part], body.template, own)
        squares, used = squares + float(off @ off), used + len(off)
    turn, shift = _frame(body.template, wanted, rotation[count >= 2])
    angle = np.full(len(points), np.nan)
    angle[count >= 2] = np.unwrap(np.angle(rotation[count >= 2] / turn))
    return ClusterPose(
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
    z = np.where(seen, points, 0)
    rotation, position = rigid_poses(z, seen, template)
    off = np.abs(z - position[:, None] - rotation[:, None] * template)
    far = seen & (off > _OUTLIER * own)
    far &= ((seen & ~far).sum(axis=1) >= 3)[:, None]
    if far.any():
        seen &= ~far
        z[far] = 0
        rotation, position = rigid_poses(z, seen, template)
        off = np.abs(z - position[:, None] - rotation[:, None] * template)
    count = seen.sum(axis=1)
    known = count >= 2
    unknown = np.where(known, 1.0, np.nan)
    return rotation * unknown, position * unknown, count, off[seen & known[:, None]]


def _frame(template: ComplexArray, wanted: ComplexArray | None, rotation: ComplexArray) -> tuple[complex, complex]:
    """Turn and shift that take the template into the body's frame."""
    if wanted is None:
        return complex(np.exp(1j * np.angle(rotation.mean()))), 0j
    known = np.isfinite(wanted)
    a, b = template[known], wanted[known]
    moment = np.sum((b - b.mean()) * np.conj(a - a.mean()))
    turn = moment / abs(moment)
    return complex(turn), complex(b.mean() - turn * a.mean())
