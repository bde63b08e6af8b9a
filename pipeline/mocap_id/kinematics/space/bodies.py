"""Rigid bodies among the markers of a trial in space, divisions into bodies, and joints between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry import so3
from mocap_id.kinematics.constraints import Constraints
from mocap_id.kinematics.rigid_body import variance_over_time
from mocap_id.kinematics.space.rigid_body import fit_shape, mean_rotation, rigid_poses

LEAST = 3
"""Fewest markers of a body that has a rotation."""

NARROW = 0.01
"""Least width of a body, m; skin motion rotates a narrower body more than a joint does."""

_RIDGE = 1e-4  # selects, of the many common points of a hinge, the point nearest to the markers
_FEWEST = 10  # fewest frames in which both bodies of a joint are visible
_ITERATIONS = 2
_REASSIGNMENTS = 4
_CLUSTERS = (2, 3, 4)
_FEW = 14  # most markers of a body for which all rigid triples are tested
_FREE = 0.15  # lower limit of the fraction of a marker's error that the pose does not absorb


@dataclass(frozen=True)
class SpatialBody:
    """Markers that move as one rigid body."""

    markers: IntArray  # (k,) columns of the trajectories, ascending
    rotation: FloatArray  # (F, 3, 3) rotation of the body; NaN where unknown
    origin: FloatArray  # (F, 3) centroid of the markers, m; NaN where unknown
    residual: FloatArray  # (M,) rms distance of all markers from their positions on the body, m; inf if unknown
    width: float  # largest rms distance, in one direction, of the markers from the line that fits them best, m

    @property
    def rms_residual(self) -> float:
        """rms of the residuals of the body's own markers, m."""
        return float(np.sqrt(np.mean(self.residual[self.markers] ** 2)))

    def local(self, points: FloatArray) -> FloatArray:
        """Return trajectories (F, k, 3) in the body's frame, m."""
        return np.asarray((points - self.origin[:, None]) @ self.rotation)


def fit_spatial_body(points: FloatArray, markers: IntArray) -> SpatialBody:
    """Fit a rigid body to the columns ``markers`` of the trajectories (F, M, 3), m."""
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
    """Return trajectories (F, k, 3) minus means (0 where missing), the means, and numbers of visible frames (k,)."""
    seen = np.isfinite(local[..., 0])
    counts = np.asarray(seen.sum(axis=0))
    mean = np.where(seen[..., None], local, 0.0).sum(axis=0) / np.maximum(counts, 1)[:, None]
    return np.where(seen[..., None], local - mean, 0.0), mean, counts


def _leave_one_out_factors(shape: FloatArray) -> FloatArray:
    """Return matrices (k, 3, 3) that map each marker's residual to its residual from the pose of the other markers.

    The pose of a body absorbs the part H (3, 3) of a marker's error. Without the marker, the residual is (I - H)⁻¹
    times as large. The factor is limited in directions that the other markers hardly determine (with three markers,
    there is one such direction).
    """
    known: BoolArray = np.asarray(np.isfinite(shape).all(axis=1))
    centred = np.where(known[:, None], shape, 0.0)
    inertia = np.sum(centred**2) * np.eye(3) - centred.T @ centred
    cross = so3.hat(centred)
    turned = cross @ np.linalg.pinv(inertia, rcond=1e-6) @ cross.transpose(0, 2, 1)
    share = np.eye(3) / max(int(known.sum()), 1) + turned
    values, vectors = np.linalg.eigh(np.eye(3) - share)
    return np.asarray((vectors / np.maximum(values, _FREE)[:, None, :]) @ vectors.transpose(0, 2, 1))


class SpatialBodies:
    """Rigid bodies of some markers (columns), and ways to divide the markers into bodies. Fits are cached.

    The trajectories ``points`` (F, M, 3) are in m, NaN where missing.
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
        """Return the bodies of groups of markers, after each marker is reassigned to the body that fits it best.

        A marker changes its body only if its residual there is below ``stay`` times the present one. A group with fewer
        than three markers is dropped.
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
        """Return ways to divide some markers (k,) into two bodies.

        The first groups are clusters (average linkage on the standard deviations of mutual distances), and every marker
        with the two markers whose distances from it vary least. ``own`` (k, k), m, replaces these standard deviations
        if given.
        """
        if len(markers) < 2 * LEAST:
            return []
        spread = self._spread[np.ix_(markers, markers)]
        if own is not None:
            spread = np.sqrt(self.constraints.constrained_variance(own**2, markers))
        pairs: dict[bytes, tuple[SpatialBody, SpatialBody]] = {}
        for inside in {group.tobytes(): group for group in _propose_groups(spread)}.values():
            groups = [markers[inside], markers[~inside]]
            if min(map(len, groups)) < LEAST:
                continue
            for bodies in (self.reassign_markers(groups), tuple(map(self.body, groups))):
                complete = len(bodies) == 2 and sum(len(body.markers) for body in bodies) == len(markers)
                if complete and min(body.width for body in bodies) >= NARROW:
                    first, second = sorted(bodies, key=lambda body: int(body.markers[0]))
                    pairs[first.markers.tobytes()] = first, second
        return list(pairs.values())


def _propose_groups(spread: FloatArray) -> list[BoolArray]:
    """Return groups of markers with small standard deviations ``spread`` (k, k) of distances, each as flags (k,)."""
    tree = linkage(squareform(spread, checks=False), "average")
    labels = [fcluster(tree, count, "maxclust") for count in _CLUSTERS]
    starts = [each == label for each in labels for label in np.unique(each)]
    if len(spread) <= _FEW:
        starts += [np.isin(np.arange(len(spread)), order[:LEAST]) for order in np.argsort(spread, axis=1)]
    return starts


def distance_deviation(points: FloatArray) -> FloatArray:
    """Return the standard deviation (M, M), m, of mutual distances; the largest for pairs never visible together."""
    count = points.shape[1]
    deviation = np.full((count, count), np.nan)
    for marker in range(count):
        variance, counts = variance_over_time(np.linalg.norm(points - points[:, marker : marker + 1], axis=2))
        deviation[marker] = np.where(counts > 1, np.sqrt(variance), np.nan)
    known = np.isfinite(deviation)
    deviation = np.where(known, deviation, deviation[known].max() if known.any() else 0.0)
    deviation = (deviation + deviation.T) / 2
    np.fill_diagonal(deviation, 0.0)
    return np.asarray(deviation)


@dataclass(frozen=True)
class SpatialPairJoint:
    """Point that two bodies share, and their rotation about it.

    Two bodies that hardly move relative to each other share any point. At a joint, ``residual`` is therefore far below
    ``free``.
    """

    in_first: FloatArray  # (3,) point in the first body's frame, m
    in_second: FloatArray  # (3,) point in the second body's frame, m
    residual: float  # rms distance between the two points over the frames, m; inf if hardly visible together
    free: float  # rms motion of one body's markers in the other's frame, m; the smaller of the two
    arc: float  # 2.5 to 97.5 % range of the relative rotation about its main axis, rad


def fit_pair_joint(first: SpatialBody, second: SpatialBody) -> SpatialPairJoint:
    """Fit the common point of two bodies by linear least squares (SCoRE).

    The points x of the first and y of the second body satisfy ``x - C y = d`` in the first body's frame, with the
    relative rotation C and the second body's origin d.
    """
    turn = np.swapaxes(first.rotation, 1, 2) @ second.rotation
    shift = np.einsum("fji,fj->fi", first.rotation, second.origin - first.origin)
    both = np.isfinite(shift[:, 0])
    if both.sum() < _FEWEST:
        return SpatialPairJoint(np.zeros(3), np.zeros(3), np.inf, 0.0, 0.0)
    turn, shift = turn[both], shift[both]
    mean, back = turn.mean(axis=0), -np.einsum("fji,fj->fi", turn, shift)
    normal = np.block([[np.eye(3), -mean], [-mean.T, np.eye(3)]]) + _RIDGE * np.eye(6)
    solution = np.linalg.solve(normal, np.concatenate([shift.mean(axis=0), back.mean(axis=0)]))
    off = solution[:3] - turn @ solution[3:] - shift
    free = min(_rms(first.residual[second.markers]), _rms(second.residual[first.markers]))
    return SpatialPairJoint(solution[:3], solution[3:], _rms(np.linalg.norm(off, axis=1)), free, _arc(turn))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _arc(turn: FloatArray) -> float:
    """Return the 2.5 to 97.5 % range of rotations (F, 3, 3) about their main axis, rad."""
    vector = so3.log(mean_rotation(turn).T @ turn)
    _, axes = np.linalg.eigh(vector.T @ vector)
    angle = np.sort(vector @ axes[:, 2])
    last = len(angle) - 1
    low, high = np.interp([0.025 * last, 0.975 * last], np.arange(len(angle)), angle)
    return float(high - low)
