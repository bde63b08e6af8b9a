"""First guess of a chain in space: marker clusters as rigid bodies, their common points, and slides on the bones.

A cluster that is fixed to a plate keeps its shape while it moves by centimetres on the bone. The distances between its
markers do not change, but the two clusters of a joint then locate the joint centre at two different points. If these
are farther apart than errors of single markers explain, the fit includes a slide of the joint. Without it, the
displacement would rotate the clusters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id.kinematics.space.rigid_body import fit_shape, rigid_poses

_FAR = 0.3  # m; typical distance of a joint from its clusters
_BEYOND = 2.5  # least ratio of the slide to the displacement that single markers explain; up to 1.8 without a slide
_LEAST = 0.001  # m
_USUAL = 0.95  # fraction of the frames used; the others may contain swapped markers
_SOFT = 0.01  # m; typical motion of the shared point


@dataclass(frozen=True)
class Clusters:
    """Marker clusters as rigid bodies, whose axes are parallel to those of the trial in one reference frame."""

    local: FloatArray  # (M, 3) marker coordinates relative to the centroid of their cluster, m
    rotation: FloatArray  # (F, n + 1, 3, 3) cluster to trial
    origin: FloatArray  # (F, n + 1, 3) m
    noise: FloatArray  # (n + 1,) rms rotation about the worst direction that the residuals explain, rad
    sd: FloatArray  # (n + 1,) standard deviation of one coordinate of a marker in its cluster, m

    def median_position(self, segment: int, track: FloatArray) -> FloatArray:
        """Return the median position (3,) of a trajectory (F, 3) in the frame of a cluster, m."""
        local = np.einsum("fji,fj->fi", self.rotation[:, segment], track - self.origin[:, segment])
        return np.asarray(np.nanmedian(local, axis=0))

    def relative_rotation(self, parent: int, child: int) -> FloatArray:
        """Return the rotation (F, 3, 3) of a child's cluster in its parent's cluster."""
        return np.asarray(np.swapaxes(self.rotation[:, parent], 1, 2) @ self.rotation[:, child])


def fit_clusters(points: FloatArray, segment: IntArray, reference: int) -> Clusters:
    """Fit a rigid body to the markers of every segment, with the axes of the trial in frame ``reference``.

    ``points`` (F, M, 3) are marker positions, m, NaN where missing, and ``segment`` (M,) their segments.
    """
    local = np.full((points.shape[1], 3), np.nan)
    rotations, origins, noise, variances = [], [], [], []
    for k in range(int(segment.max()) + 1):
        here = np.flatnonzero(segment == k)
        start = points[reference, here] - np.nanmean(points[reference, here], axis=0)
        shape = local[here] = fit_shape(points[:, here], start)
        rotation, origin, _ = rigid_poses(points[:, here], shape)
        off = points[:, here] - origin[:, None] - np.einsum("fij,mj->fmi", rotation, shape)
        known = shape[np.isfinite(shape).all(axis=1)]
        variance = np.nanmean(off**2) * len(known) / max(len(known) - 2, 1)
        inertia = np.linalg.eigvalsh(np.sum(known**2) * np.eye(3) - known.T @ known)
        rotations.append(rotation)
        origins.append(origin)
        noise.append(float(np.sqrt(variance / inertia[0])))
        variances.append(variance)
    turns, places = np.stack(rotations, axis=1), np.stack(origins, axis=1)
    return Clusters(local, turns, places, np.array(noise), np.sqrt(np.array(variances)))


def fit_shared_point(clusters: Clusters, parent: int, child: int) -> tuple[FloatArray, FloatArray]:
    """Return the point that moves least between two bodies, in the frames of both (3,), m.

    This is the symmetrical centre of rotation (SCoRE, Ehrig et al. 2006), with a weak pull to the middle between the
    bodies for directions that the motion does not determine.
    """
    own, other = clusters.rotation[:, parent], clusters.rotation[:, child]
    apart = clusters.origin[:, child] - clusters.origin[:, parent]
    rows = np.concatenate([own, -other], axis=2).reshape(-1, 6)
    likely = np.concatenate(
        [np.einsum("fji,fj->fi", own, apart).mean(axis=0), -np.einsum("fji,fj->fi", other, apart).mean(axis=0)]
    )
    pull = (_SOFT / _FAR) ** 2 * len(own)
    inverse = np.linalg.inv(rows.T @ rows + pull * np.eye(6))
    point = inverse @ (rows.T @ apart.reshape(-1) + pull * likely / 2)
    return point[:3], point[3:]


def find_joint_slides(clusters: Clusters, segment: IntArray, parents: Sequence[int]) -> FloatArray:
    """Return the displacement (F, n, 3), m, between both clusters at each joint that slides; 0 at the other joints."""
    slides = np.zeros((len(clusters.rotation), len(parents), 3))
    for j, parent in enumerate(parents):
        centre, own = fit_shared_point(clusters, parent, j + 1)
        ends = [
            clusters.origin[:, k] + clusters.rotation[:, k] @ place for k, place in ((parent, centre), (j + 1, own))
        ]
        apart = np.einsum("fji,fj->fi", clusters.rotation[:, parent], ends[1] - ends[0])
        square = np.sort(np.sum((apart - np.median(apart, axis=0)) ** 2, axis=1))
        size = float(np.sqrt(square[: max(int(_USUAL * len(square)), 1)].mean() / 3))
        explained = sum(_variance_at(clusters, segment, k, p) for k, p in ((parent, centre), (j + 1, own)))
        if size > max(_LEAST, _BEYOND * float(np.sqrt(explained))):
            slides[:, j] = apart
    return slides


def _variance_at(clusters: Clusters, segment: IntArray, k: int, point: FloatArray) -> float:
    """Return the variance per axis, m², of a point of a cluster from independent errors of its markers."""
    local = clusters.local[segment == k]
    local = local[np.isfinite(local).all(axis=1)]
    inertia = np.sum(local**2) * np.eye(3) - local.T @ local
    lever = so3.hat(point)
    turned = np.trace(lever @ np.linalg.solve(inertia, lever.T)) / 3
    return float(clusters.sd[k] ** 2 * (1 / len(local) + turned))


CentreEstimator: TypeAlias = Literal["score", "sphere", "helical"]

_TURN = 0.25  # lag between the two poses of a finite rotation, as a fraction of the frames
_LEAST_TURN = 1e-3  # weight of the child's mean position, for directions that the motion does not determine


def _fit_sphere(turn: FloatArray, origin: FloatArray, local: FloatArray) -> FloatArray:
    """Return the common centre (3,) of the spheres on which markers (k, 3) of the child move in the parent, m."""
    places = origin[:, None] + np.einsum("fij,kj->fki", turn, local)
    middle = places.mean(axis=0)
    about = places - middle
    square = (about**2).sum(axis=2)
    rows = 2 * about.reshape(-1, 3)
    right = (square - square.mean(axis=0) + 2 * np.einsum("fki,ki->fk", about, middle)).reshape(-1)
    return _solve(rows, right, places.mean(axis=(0, 1)))


def _fit_helical_axes(turn: FloatArray, origin: FloatArray) -> FloatArray:
    """Return the point (3,) nearest to the helical axes of the child in the parent, m."""
    lag = max(int(_TURN * len(turn)), 1)
    finite = turn[lag:] @ np.swapaxes(turn[:-lag], 1, 2)
    shift = origin[lag:] - np.einsum("fij,fj->fi", finite, origin[:-lag])
    return _solve((np.eye(3) - finite).reshape(-1, 3), shift.reshape(-1), origin.mean(axis=0))


def estimate_centre(
    estimator: CentreEstimator, clusters: Clusters, parent: int, child: int, local: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return a joint centre (3,) in the frame of the parent's cluster and in that of the child's cluster, m.

    ``local`` (k, 3) are the markers of the child in the frame of its cluster, m.
    """
    if estimator == "score":
        return fit_shared_point(clusters, parent, child)
    turn, origin = _express_in_parent(clusters, parent, child)
    centre = _fit_sphere(turn, origin, local) if estimator == "sphere" else _fit_helical_axes(turn, origin)
    return centre, np.einsum("fji,fj->fi", turn, centre - origin).mean(axis=0)


def _express_in_parent(clusters: Clusters, parent: int, child: int) -> tuple[FloatArray, FloatArray]:
    """Return rotation (F, 3, 3) and origin (F, 3), m, of the child's cluster in the parent's cluster."""
    apart = clusters.origin[:, child] - clusters.origin[:, parent]
    return clusters.relative_rotation(parent, child), np.einsum("fji,fj->fi", clusters.rotation[:, parent], apart)


def _solve(rows: FloatArray, right: FloatArray, likely: FloatArray) -> FloatArray:
    """Return the least-squares solution with a weak pull to a likely value."""
    square = rows.T @ rows
    pull = _LEAST_TURN * np.linalg.eigvalsh(square)[-1] * np.eye(3)
    return np.asarray(np.linalg.solve(square + pull, rows.T @ right + pull @ likely))
