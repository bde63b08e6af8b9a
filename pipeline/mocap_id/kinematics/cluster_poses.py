"""Measured poses of single marker clusters, without joints between them.

In a chain, joints connect the segments. The pose of a single cluster does not depend on joints, so the ends of two
clusters may move apart at their joint. With the chain's marker coordinates as ``target``, the pose is that of the
chain's segment frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray, chunks
from mocap_id.kinematics.frame_sampling import frames_along_motion
from mocap_id.kinematics.rigid_body import fit_body, marker_residuals, rigid_poses

LEAST_MARKERS = 2
"""Fewest markers that determine a pose."""
_FRAMES = 600  # for the shape of a cluster
_LEAST_SEEN = 5  # fewest of these frames with a visible marker; other markers are ignored
_LEAST_SPREAD = 0.01  # m, least rms distance of the markers from their centroid that determines an angle
_OUTLIER = 5.0  # samples farther than this many times the marker's own residual are left out
_LEAST_RESIDUAL = 1e-3  # m; lower limit of this residual


@dataclass(frozen=True)
class ClusterPose:
    """Pose of one cluster in every frame; NaN with fewer than two visible markers."""

    markers: IntArray  # (k,) columns of the markers used
    local: ComplexArray  # (k,) coordinates of these markers in the body's frame, m
    position: ComplexArray  # (F,) centroid of the fitted shape in the plane frame, m
    angle: FloatArray  # (F,) unwrapped angle of the body's frame in the plane frame, rad
    count: IntArray  # (F,) number of markers used
    residual: float  # rms distance of the markers from their positions on the body, m


def measure_cluster(points: ComplexArray, target: ComplexArray | None = None) -> ClusterPose | None:
    """Fit a rigid shape to the trajectories (F, m) of a cluster, and its pose in every frame.

    Trajectories are in metres, NaN where missing. The result is None for fewer than two markers, markers at one point,
    or fewer than two frames with two visible markers. The body frame is defined by the markers' coordinates ``target``
    (m,), m. By default, its origin is the centroid, and its axes are parallel to the plane frame on average.
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
        points, target = points[:, markers], None if target is None else target[markers]
    some = points[chosen]
    body = fit_body(some, np.arange(len(markers)))
    if not np.sqrt(np.mean(np.abs(body.template) ** 2)) > _LEAST_SPREAD:
        return None
    own = np.maximum(marker_residuals(body, some), _LEAST_RESIDUAL)
    rotation, position = (np.full(len(points), np.nan, dtype=np.complex128) for _ in range(2))
    count, squares, used = np.zeros(len(points), dtype=np.int64), 0.0, 0
    for part in chunks(len(points)):
        rotation[part], position[part], count[part], off = _fit_poses(points[part], body.template, own)
        squares, used = squares + float(off @ off), used + len(off)
    turn, shift = _align_frame(body.template, target, rotation[count >= LEAST_MARKERS])
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


def _fit_poses(
    points: ComplexArray, template: ComplexArray, own: FloatArray
) -> tuple[ComplexArray, ComplexArray, IntArray, FloatArray]:
    """Return rotation and position (f,), NaN if unknown, number of markers used (f,), and their residuals, m.

    Samples whose residual is far above the usual residual ``own`` (m,), m, of their marker are left out.
    """
    seen = np.isfinite(points)
    rotation, position, off = _fit_template(points, seen, template)
    while True:
        far = np.any(seen & (off > _OUTLIER * own), axis=1) & (seen.sum(axis=1) > LEAST_MARKERS + 1)
        rows = np.flatnonzero(far)
        if not len(rows):
            break
        seen[rows, _find_worst_marker(points[rows], seen[rows], template)] = False
        rotation[rows], position[rows], off[rows] = _fit_template(points[rows], seen[rows], template)
    count = seen.sum(axis=1)
    known = count >= LEAST_MARKERS
    unknown = np.where(known, 1.0, np.nan)
    return rotation * unknown, position * unknown, count, off[seen & known[:, None]]


def _fit_template(
    points: ComplexArray, seen: BoolArray, template: ComplexArray
) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Return rotation and position (f,), and the distances (f, m) of all markers from the fitted template, m."""
    z = np.where(seen, points, 0)
    rotation, position = rigid_poses(z, seen, template)
    return rotation, position, np.abs(z - position[:, None] - rotation[:, None] * template)


def _find_worst_marker(points: ComplexArray, seen: BoolArray, template: ComplexArray) -> IntArray:
    """Return the marker (f,) whose removal improves the fit most in each frame.

    The largest residual is not a reliable sign, because an outlier also increases the residuals of the others.
    """
    cost = np.full(seen.shape, np.inf)
    for k in range(seen.shape[1]):
        others = seen.copy()
        others[:, k] = False
        off = _fit_template(points, others, template)[2]
        cost[:, k] = np.where(seen[:, k], np.sum(np.where(others, off**2, 0), axis=1), np.inf)
    return np.asarray(np.argmin(cost, axis=1))


def _align_frame(
    template: ComplexArray, target: ComplexArray | None, rotation: ComplexArray
) -> tuple[complex, complex]:
    """Return rotation and shift from the template's frame to the body's frame as complex numbers."""
    if target is None:
        return complex(np.exp(1j * np.angle(rotation.mean()))), 0j
    known = np.isfinite(target)
    a, b = template[known], target[known]
    moment = np.sum((b - b.mean()) * np.conj(a - a.mean()))
    turn = moment / abs(moment)
    return complex(turn), complex(b.mean() - turn * a.mean())
