"""Measured poses of single marker clusters, without joints between them.

A chain pins its segments to each other. The pose of a cluster alone shows how the body really moved, including gaps at
the joints. Its frame is the frame of the chain's segment, so that results in one frame are valid in the other.
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
_LEAST_SEEN = 5  # of these frames; markers seen less are ignored
_LEAST_SPREAD = 0.01  # m, least rms distance of the markers from their centroid that determines an angle
_OUTLIER = 5.0  # times a marker's own residual: farther samples are left out of a frame
_LEAST_RESIDUAL = 1e-3  # m; least residual for this limit


@dataclass(frozen=True)
class ClusterPose:
    """Pose of one cluster in every frame.

    Parameters
    ----------
    markers : (k,) int array
        Columns of the markers used.
    local : (k,) complex array
        Their coordinates in the body's frame, m; x + i y.
    position : (F,) complex array
        Centroid of all k markers of the fitted shape in the plane frame, m; NaN with fewer than two markers.
    angle : (F,) array
        Unwrapped angle of the body's frame from the plane frame, rad; NaN with fewer than two markers.
    count : (F,) int array
        Number of markers used in each frame.
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
    """Fit a rigid shape to a cluster, and its pose to every frame.

    Parameters
    ----------
    points : (F, m) complex array
        Markers in the plane frame, m; NaN where unseen.
    wanted : (m,) complex array, optional
        Coordinates of the markers that define the body's frame, m. By default the origin is the centroid of the
        cluster, and the frame is parallel to the plane frame on average.

    Returns
    -------
    ClusterPose or None
        None for fewer than two markers, markers at one point, or markers that are never seen together.
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
        rotation[part], position[part], count[part], off = _fit_poses(points[part], body.template, own)
        squares, used = squares + float(off @ off), used + len(off)
    turn, shift = _align_frame(body.template, wanted, rotation[count >= LEAST_MARKERS])
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
    """Return rotation and position (f,; NaN if unknown), markers used (f,), and their residual distances, m."""
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
    """Return rotation and position (f,), and the distances of all markers from their places (f, m), m."""
    z = np.where(seen, points, 0)
    rotation, position = rigid_poses(z, seen, template)
    return rotation, position, np.abs(z - position[:, None] - rotation[:, None] * template)


def _find_worst_marker(points: ComplexArray, seen: BoolArray, template: ComplexArray) -> IntArray:
    """Return the marker (f,) whose removal improves the fit most; a marker that jumps distorts the fit of all."""
    cost = np.full(seen.shape, np.inf)
    for k in range(seen.shape[1]):
        others = seen.copy()
        others[:, k] = False
        off = _fit_template(points, others, template)[2]
        cost[:, k] = np.where(seen[:, k], np.sum(np.where(others, off**2, 0), axis=1), np.inf)
    return np.asarray(np.argmin(cost, axis=1))


def _align_frame(
    template: ComplexArray, wanted: ComplexArray | None, rotation: ComplexArray
) -> tuple[complex, complex]:
    """Return the turn and the shift from the template to the body's frame."""
    if wanted is None:
        return complex(np.exp(1j * np.angle(rotation.mean()))), 0j
    known = np.isfinite(wanted)
    a, b = template[known], wanted[known]
    moment = np.sum((b - b.mean()) * np.conj(a - a.mean()))
    turn = moment / abs(moment)
    return complex(turn), complex(b.mean() - turn * a.mean())
