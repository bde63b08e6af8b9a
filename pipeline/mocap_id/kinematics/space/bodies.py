"""Rigid bodies among the markers of a trial in space, at any level of detail."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id.kinematics.constraints import Constraints
from mocap_id.kinematics.space.rigid_body import fit_shape, rigid_poses

LEAST = 3
"""Fewest markers of a body that has a rotation."""

NARROW = 0.01
"""Least width of a body, m; the skin turns a narrower one about its line by more than a joint does."""

_ITERATIONS = 2
_REASSIGNMENTS = 4
_CLUSTERS = (2, 3, 4)
_FEW = 14  # markers of a body that is small enough to try all its rigid triples
_FREE = 0.15  # least share of a marker's error that its own body's pose does not absorb, in any direction


@dataclass(frozen=True)
class SpatialBody:
    """Markers that move as one rigid body.

    Parameters
    ----------
    markers : (k,) int array
        Columns of the trajectories, ascending.
    rotation, origin : (F, 3, 3) and (F, 3) arrays
        Pose in each frame; the origin is the centroid of the markers, m. NaN where unknown.
    residual : (M,) array
        rms distance of every marker of the trial from its mean place on the body, m; inf where unknown. The body's own
        markers are placed by the others.
    width : float
        rms distance of the markers from the line that fits them best, along the direction in which it is largest, m.
    """

    markers: IntArray
    rotation: FloatArray
    origin: FloatArray
    residual: FloatArray
    width: float

    @property
    def rms_residual(self) -> float:
        """Return the rms of the residuals of the body's own markers, m."""
        return float(np.sqrt(np.mean(self.residual[self.markers] ** 2)))

    def local(self, points: FloatArray) -> FloatArray:
        """Return trajectories (F, k, 3) in the body's frame, m."""
        return np.asarray((points - self.origin[:, None]) @ self.rotation)


def fit_spatial_body(points: FloatArray, markers: IntArray) -> SpatialBody:
    """Fit a rigid body to some markers of the trajectories (F, M, 3), m."""
    shape = fit_shape(points[:, markers], iterations=_ITERATIONS)
    rotation, origin, _ = rigid_poses(points[:, markers], shape)
    back = (points - origin[:, None]) @ rotation
    off, _, counts = subtract_means(back)
    for place, marker in zip(_leave_one_out_factors(shape), markers, strict=True):
        off[:, marker] = off[:, marker] @ place
    square = np.einsum("fmi,fmi->m", off, off) / np.maximum(counts, 1)
    residual = np.where(counts >= max(3, 0.02 * len(points)), np.sqrt(square), np.inf)
    known = shape[np.isfinite(shape).all(axis=1)]
    width = float(np.linalg.svd(known, compute_uv=False)[1] / np.sqrt(len(known))) if len(known) >= LEAST else 0.0
    return SpatialBody(markers, rotation, origin, residual, width)


def subtract_means(local: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return trajectories (F, k, 3) minus their means, 0 where unseen, the means (k, 3), and the frames seen (k,)."""
    seen = np.isfinite(local[..., 0])
    counts = np.asarray(seen.sum(axis=0))
    mean = np.where(seen[..., None], local, 0.0).sum(axis=0) / np.maximum(counts, 1)[:, None]
    return np.where(seen[..., None], local - mean, 0.0), mean, counts


def _leave_one_out_factors(shape: FloatArray) -> FloatArray:
    """Return for every marker the matrix (k, 3, 3) from its residual to the one with a pose from the other markers.

    The pose of a body absorbs the share H of a marker's error. Without the marker, the residual is (I - H)⁻¹ times as
    large. Directions that the other markers hardly show are limited: three markers leave one direction free.
    """
    known: BoolArray = np.asarray(np.isfinite(shape).all(axis=1))
    centred = np.where(known[:, None], shape, 0.0)
    inertia = np.sum(centred**2) * np.eye(3) - centred.T @ centred
    cross = so3.hat(centred)
    share = np.eye(3) / max(int(known.sum()), 1) + cross @ np.linalg.pinv(inertia, rcond=1e-6) @ cross.transpose(
        0, 2, 1
    )
    values, vectors = np.linalg.eigh(np.eye(3) - share)
    return np.asarray((vectors / np.maximum(values, _FREE)[:, None, :]) @ vectors.transpose(0, 2, 1))


class SpatialBodies:
    """Rigid bodies of some markers, and their divisions. Fits are cached.

    Parameters
    ----------
    points : (F, M, 3) array
        Trajectories, m; NaN where unseen.
    markers : int array
        Columns to sort, ascending.
    constraints : Constraints
    """

    def __init__(self, points: FloatArray, markers: IntArray, constraints: Constraints) -> None:
        self.points, self.markers, self.constraints = points, markers, constraints
        self._bodies: dict[bytes, SpatialBody] = {}
        spread = np.full((points.shape[1],) * 2, np.nan)
        spread[np.ix_(markers, markers)] = np.sqrt(
            constraints.constrained_variance(distance_deviation(points[:, markers]) ** 2, markers)
        )
        self._spread = spread

    def body(self, markers: IntArray) -> SpatialBody:
        """Return the rigid body of some markers."""
        key = markers.tobytes()
        if key not in self._bodies:
            self._bodies[key] = fit_spatial_body(self.points, markers)
        return self._bodies[key]

    def reassign_markers(self, groups: list[IntArray], stay: float = 1.0) -> tuple[SpatialBody, ...]:
        """Return bodies from groups of markers, after each of their markers has moved to the body that fits it best.

        A marker leaves its body for a residual below the share ``stay`` of the present one. A group that loses all but
        two markers is dropped.
        """
        among = np.sort(np.concatenate(groups))
        groups = [group for group in groups if len(group) >= LEAST]
        for _ in range(_REASSIGNMENTS):
            if len(groups) < 2:
                break
            residuals = np.stack([self.body(group).residual[among] for group in groups])
            residuals *= np.stack([np.where(np.isin(among, group), stay, 1.0) for group in groups])
            best = self.constraints.nearest_bodies(np.minimum(residuals, 1e3) ** 2, among)
            regrouped = [among[best == index] for index in range(len(groups))]
            regrouped = [group for group in regrouped if len(group) >= LEAST]
            if len(regrouped) == len(groups) and all(map(np.array_equal, regrouped, groups)):
                break
            groups = regrouped
        return tuple(self.body(group) for group in groups)

    def divisions(self, markers: IntArray, own: FloatArray | None = None) -> list[tuple[SpatialBody, SpatialBody]]:
        """Return ways to divide some markers into two bodies.

        They start from the clusters of average linkage on the deviation of the mutual distances, and from every marker
        with the two that are most rigid with it.

        Parameters
        ----------
        markers : (k,) int array
        own : (k, k) array, optional
            The part of the deviations to start from, m; default: all.
        """
        if len(markers) < 2 * LEAST:
            return []
        spread = self._spread[np.ix_(markers, markers)]
        if own is not None:
            spread = np.sqrt(self.constraints.constrained_variance(own**2, markers))
        starts = _propose_groups(spread)
        found: dict[bytes, tuple[SpatialBody, SpatialBody]] = {}
        for inside in {start.tobytes(): start for start in starts}.values():
            groups = [markers[inside], markers[~inside]]
            if min(map(len, groups)) < LEAST:
                continue
            for bodies in (self.reassign_markers(groups), tuple(map(self.body, groups))):
                complete = len(bodies) == 2 and sum(len(body.markers) for body in bodies) == len(markers)
                if complete and min(body.width for body in bodies) >= NARROW:
                    first, second = sorted(bodies, key=lambda body: int(body.markers[0]))
                    found[first.markers.tobytes()] = first, second
        return list(found.values())


def _propose_groups(spread: FloatArray) -> list[BoolArray]:
    """Return sets of markers that are rigid by a spread (k, k) of the distances: clusters, and triples of few."""
    tree = linkage(squareform(spread, checks=False), "average")
    labels = [fcluster(tree, count, "maxclust") for count in _CLUSTERS]
    starts = [each == label for each in labels for label in np.unique(each)]
    if len(spread) <= _FEW:
        starts += [np.isin(np.arange(len(spread)), order[:LEAST]) for order in np.argsort(spread, axis=1)]
    return starts


def distance_deviation(points: FloatArray) -> FloatArray:
    """Return the standard deviation (M, M) of every mutual distance, m; the largest for pairs never seen together."""
    count = points.shape[1]
    deviation = np.full((count, count), np.nan)
    for marker in range(count):
        distance = np.linalg.norm(points - points[:, marker : marker + 1], axis=2)
        seen = np.isfinite(distance)
        counts = seen.sum(axis=0)
        filled = np.where(seen, distance, 0.0)
        mean = filled.sum(axis=0) / np.maximum(counts, 1)
        square = np.where(seen, distance - mean, 0.0) ** 2
        deviation[marker] = np.where(counts > 1, np.sqrt(square.sum(axis=0) / np.maximum(counts, 1)), np.nan)
    known = np.isfinite(deviation)
    deviation = np.where(known, deviation, deviation[known].max() if known.any() else 0.0)
    deviation = (deviation + deviation.T) / 2
    np.fill_diagonal(deviation, 0.0)
    return np.asarray(deviation)
