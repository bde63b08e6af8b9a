"""Measured poses of single marker clusters, without joints between them, and the joints corrected with them.

In a chain, joints connect the segments. The pose of a single cluster does not depend on joints, so the ends of two
clusters may move apart at their joint. With the chain's marker coordinates as ``target``, the pose is that of the
chain's segment frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray, chunks
from mocap_id.kinematics.bundle import frames_along_motion
from mocap_id.kinematics.joint import fit_body, marker_residuals, planar_poses

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
    # rotation and shift from the template's frame to the body's frame
    known = count >= LEAST_MARKERS
    if target is None:
        turn, shift = complex(np.exp(1j * np.angle(rotation[known].mean()))), 0j
    else:
        both = np.isfinite(target)
        a, b = body.template[both], target[both]
        moment = np.sum((b - b.mean()) * np.conj(a - a.mean()))
        turn = complex(moment / abs(moment))
        shift = complex(b.mean() - turn * a.mean())
    angle = np.full(len(points), np.nan)
    angle[known] = np.unwrap(np.angle(rotation[known] / turn))
    local, residual = turn * body.template + shift, float(np.sqrt(squares / used))
    return ClusterPose(markers, local, position, angle, count, residual)


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
        # The marker whose removal improves the fit most is left out. The largest residual is not a reliable sign,
        # because an outlier also increases the residuals of the others.
        cost = np.full((len(rows), seen.shape[1]), np.inf)
        for k in range(seen.shape[1]):
            others = seen[rows]
            others[:, k] = False
            square = _fit_template(points[rows], others, template)[2] ** 2
            cost[:, k] = np.where(seen[rows, k], np.sum(np.where(others, square, 0), axis=1), np.inf)
        seen[rows, np.argmin(cost, axis=1)] = False
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
    rotation, position = planar_poses(z, seen, template)
    return rotation, position, np.abs(z - position[:, None] - rotation[:, None] * template)


_RATIO, _RATIO_SD = 0.8, 0.4  # v: height of the lumbar joint above the hip, over its distance behind the marker
_INDEPENDENT = 3.0  # independent observations in one trial, because gaps recur with the movement
_RANGE = 0.5  # rad; least range of the hip. A motion of 10 mm in proportion to it then shifts the hip by about 15 mm
_FEWEST = 10  # frames
_LEAST_GAP = 1e-5  # m; least gap, so that an ankle without rotation stays in place in recordings without noise
_EXPLAINED = 0.5  # largest part of the ankle's motion that a foot leaves that really lifts; 0.06 to 0.1 in simulations
_FOOT_M = 0.25  # length of a foot: if the heel rises by h, the foot rotates by h / length
_ANKLE_SD = 0.01  # m; standard deviation of the ankle from a joint fit if the foot moves

REMAINING = 0.4
"""Fraction of the hip's error from a bending trunk that remains after the correction, as a standard deviation."""

BENDS_M = 0.0025
"""Least displacement of the hip by a trunk that bends, m; skin on a rigid trunk causes up to 1 mm."""


@dataclass(frozen=True)
class HipShift:
    """Displacement of the hip by a trunk that bends; zero if it is unknown."""

    place: complex = 0j  # change of the hip's position in the thigh's frame, m
    slide: float = 0.0  # range of the pelvis markers' motion along the trunk, m
    across: FloatArray | None = None  # (F,) motion of the hip across the thigh relative to a rigid trunk, m; has NaN


@dataclass(frozen=True)
class AnklePosition:
    """Position of the ankle."""

    foot: complex  # position in the foot's frame, m
    shank: complex  # position in the shank's frame, m
    sd: float  # standard deviation in one direction, m


def estimate_hip_shift(
    thigh: tuple[ComplexArray, FloatArray], trunk: tuple[ComplexArray, FloatArray], marker: ComplexArray
) -> HipShift:
    """Return the displacement of the hip by a bending trunk; zero if unknown.

    If the hip rotates little, its shift and its motion with the trunk cannot be separated, and the result is 0. Each
    body is given by the origin (F,), m, and the angle (F,), rad, of its frame; the trunk's y axis points from the hip
    upwards. ``marker`` (F,) is a pelvis marker in the plane frame, m. All are NaN where unknown.
    """
    below, above = np.exp(1j * thigh[1]), np.exp(1j * trunk[1])
    local = np.conj(above) * (marker - trunk[0])
    known = np.isfinite(local) & np.isfinite(thigh[0]) & np.isfinite(below)
    if np.count_nonzero(known) < _FEWEST:
        return HipShift()
    if np.ptp(np.unwrap((trunk[1] - thigh[1])[known])) < _RANGE:
        return HipShift()
    below, above, local, apart = (each[known] for each in (below, above, local, trunk[0] - thigh[0]))
    forwards = np.sign(local.real.mean())
    slide = forwards * (local.imag - local.imag.mean())
    columns = np.column_stack([below, -above, -above * slide])
    normal, target = columns.conj().T @ columns / len(columns), columns.conj().T @ apart / len(columns)
    rigid = np.linalg.solve(normal[:2, :2], target[:2])
    gap = float(np.mean(np.abs(apart - columns[:, :2] @ rigid) ** 2)) / 2
    weight = gap / (_INDEPENDENT * _RATIO_SD**2)
    normal[2, 2] += weight
    target[2] += weight * _RATIO
    place, beyond, ratio = np.linalg.solve(normal, target)
    across = np.full(len(known), np.nan)
    across[known] = (np.conj(below) * above * (beyond - rigid[1] + ratio * slide)).real
    return HipShift(complex(place - rigid[0]), float(np.ptp(np.quantile(slide, (0.01, 0.99)))), across)


def locate_ankle(
    foot: tuple[ComplexArray, FloatArray], shank: tuple[ComplexArray, FloatArray], ankle: complex
) -> AnklePosition | None:
    """Return the position of the ankle between a moving foot and the shank; None with fewer than ten common frames.

    It is that of the joint fit if only the skin of the foot moves.

    Each body is given by the origin (F,), m, and the angle (F,), rad, of its frame, NaN where unknown. ``ankle`` is the
    position in the foot's frame from the joint fit, m.
    """
    below, above = np.exp(1j * foot[1]), np.exp(1j * shank[1])
    apart = shank[0] - foot[0] - below * ankle
    known = np.isfinite(apart) & np.isfinite(above)
    if np.count_nonzero(known) < _FEWEST:
        return None
    columns, apart, still = np.column_stack([below, -above])[known], apart[known], shank[0][known]
    normal, target = columns.conj().T @ columns / len(columns), columns.conj().T @ apart / len(columns)
    gap = _measure_gap(columns, apart)
    on_still_foot = _measure_gap(np.column_stack([np.ones_like(still), columns[:, 1]]), still)
    turn = float(np.ptp(np.quantile(foot[1][known], (0.02, 0.98))))
    farthest = turn * _FOOT_M if gap < _EXPLAINED * on_still_foot else 0.0
    gap = max(gap, _LEAST_GAP**2)
    normal[0, 0] += gap / (_INDEPENDENT * _ANKLE_SD**2)
    shift = complex(np.linalg.solve(normal, target)[0])
    variance = gap / _INDEPENDENT * float(np.linalg.inv(normal)[0, 0].real)
    shift *= min(1.0, farthest / max(abs(shift), _LEAST_GAP))
    beyond = (target[1] - normal[1, 0] * shift) / normal[1, 1]
    return AnklePosition(ankle + shift, complex(beyond), float(np.sqrt(variance)))


def _measure_gap(columns: ComplexArray, apart: ComplexArray) -> float:
    """Return the mean square per coordinate, m², of what ``columns`` (F, k) do not explain of a distance (F,), m."""
    return float(np.mean(np.abs(apart - columns @ np.linalg.lstsq(columns, apart)[0]) ** 2)) / 2
