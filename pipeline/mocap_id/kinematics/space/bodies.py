"""Rigid bodies among the markers of a trial in space, divisions into bodies, and joints between them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TypeAlias

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.compilation import compiled
from mocap_id.geometry import so3
from mocap_id.kinematics.clusters import Constraints
from mocap_id.kinematics.joint import measure_range, variance_over_time

_ITERATIONS = 60
_TOLERANCE = 1e-7  # m
_OUTLIER = 3.0  # distance from its position, in medians, at which a sample has half its weight
_FLOOR = 1e-5  # m; least median distance in this comparison
_COLLINEAR = 0.02  # least ratio of width and length of a cluster with a known rotation
_SWEEPS = 12  # largest number of sweeps of Jacobi rotations; four are typical


def fit_shape(points: FloatArray, start: FloatArray | None = None, iterations: int = _ITERATIONS) -> FloatArray:
    """Fit the shape of a rigid body to its markers (generalised Procrustes analysis with gaps and robust weights).

    The coordinates (k, 3), m, are relative to their centroid, in arbitrary axes. They are NaN for markers that are
    never visible together with three markers of known coordinates. The trajectories ``points`` (F, k, 3) are in m, NaN
    where missing; a few hundred frames along the motion are enough. ``start`` (k, 3) is a first guess, m, NaN where
    unknown; by default, it is the frame with most visible markers. Two ``iterations`` are enough to compare groups of
    markers.

    Examples
    --------
    >>> triangle = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.2, 0]])
    >>> local = fit_shape(np.stack([triangle, triangle + 1.0]))
    >>> round(float(np.linalg.norm(local[1] - local[2])), 6)
    0.223607
    """
    seen: BoolArray = np.asarray(np.isfinite(points).all(axis=2))
    local = points[int(np.argmax(seen.sum(axis=1)))] if start is None else start
    weights: FloatArray = seen.astype(np.float64)
    for _ in range(iterations):
        rotation, origin, _ = rigid_poses(points, local, weights)
        back = np.einsum("fji,fkj->fki", rotation, points - origin[:, None])
        used = np.where(np.isfinite(back[..., 0]), weights, 0.0)
        total = used.sum(axis=0)
        mean = np.einsum("fk,fki->ki", used, np.where(used[..., None] > 0, back, 0.0))
        places = np.where(total[:, None] > 0, mean / np.maximum(total, 1e-12)[:, None], np.nan)
        updated = places - np.nanmean(places, axis=0) if np.isfinite(places).any() else places
        step = np.abs(updated - local)
        known = np.isfinite(step)
        grown = bool((np.isfinite(updated) != np.isfinite(local)).any())
        local = updated
        if not known.any() or (not grown and float(step[known].max()) < _TOLERANCE):
            break
        # robust weights: near 1 for usual samples and small for outliers
        distance = np.linalg.norm(back - places, axis=2)
        measured = np.isfinite(distance)
        usual = max(float(np.median(distance[measured])) if measured.any() else 0.0, _FLOOR)
        outlying = 1 / (1 + (np.where(measured, distance, 0.0) / (_OUTLIER * usual)) ** 2)
        weights = np.where(seen, outlying, 0.0)
    return np.asarray(local)


def rigid_poses(
    points: FloatArray, local: FloatArray, weights: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the pose of a rigid body in every frame, by weighted least squares (Kabsch's closed form).

    The trajectories (F, k, 3), m, are NaN where missing. ``local`` (k, 3) are the coordinates in the body's frame, m,
    NaN where unknown. The weights (k,) or (F, k) are 0 or more, by default equal. The results are the rotation
    (F, 3, 3) from the body to the frame of ``points``, the origin (F, 3) of the body's frame, m, and the number (F,) of
    markers used. The pose is NaN with fewer than three visible markers, or with markers on one line.
    """
    weight = np.ones(points.shape[:2]) * (1.0 if weights is None else weights)
    rotation, origin = np.empty((len(points), 3, 3)), np.empty((len(points), 3))
    seen = np.empty(len(points), dtype=np.int64)
    _turn_onto(np.ascontiguousarray(points), np.ascontiguousarray(local), weight, rotation, origin, seen)
    return rotation, origin, seen


def mean_rotation(rotation: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) nearest to the mean of rotations (F, 3, 3)."""
    left, _, right = np.linalg.svd(rotation.mean(axis=0))
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


@compiled
def _turn_onto(  # noqa: PLR0917
    points: FloatArray, local: FloatArray, weight: FloatArray, rotation: FloatArray, origin: FloatArray, seen: IntArray
) -> None:
    """Write the results of :func:`rigid_poses` to ``rotation``, ``origin`` and ``seen``.

    The eigenvectors v of MᵀM, with the moment M, give the axes M v of the points. The third axes complete both frames,
    so the result is not a reflection, and markers in one plane need no special case.
    """
    here, there, moment = np.empty(3), np.empty(3), np.empty((3, 3))
    for f in range(points.shape[0]):
        seen[f] = _moment(points[f], local, weight[f], here, there, moment)
        squares, axes = _principal_axes(moment)
        if seen[f] < 3 or squares[1] <= _COLLINEAR**4 * squares[0]:
            rotation[f] = np.nan
            origin[f] = np.nan
            continue
        first, second = np.zeros(3), np.zeros(3)
        for i in range(3):
            for j in range(3):
                first[i] += moment[i, j] * axes[j, 0]
                second[i] += moment[i, j] * axes[j, 1]
        _orthonormalise(first, second)
        third, own = _cross(first, second), _cross(axes[:, 0], axes[:, 1])
        for i in range(3):
            origin[f, i] = here[i]
            for j in range(3):
                rotation[f, i, j] = first[i] * axes[j, 0] + second[i] * axes[j, 1] + third[i] * own[j]
                origin[f, i] -= rotation[f, i, j] * there[j]


@compiled
def _moment(  # noqa: PLR0917
    points: FloatArray,
    local: FloatArray,
    weight: FloatArray,
    here: FloatArray,
    there: FloatArray,
    moment: FloatArray,
) -> int:
    """Write the weighted means ``here`` and ``there`` and the moment about them; return the number of markers used."""
    total, count = 0.0, 0
    here[:], there[:], moment[:] = 0.0, 0.0, 0.0
    for k in range(len(points)):
        w = weight[k]
        if w > 0 and np.isfinite(points[k, 0] + points[k, 1] + points[k, 2] + local[k, 0] + local[k, 1] + local[k, 2]):
            count += 1
            total += w
            for i in range(3):
                here[i] += w * points[k, i]
                there[i] += w * local[k, i]
    for i in range(3):
        here[i] /= max(total, 1e-12)
        there[i] /= max(total, 1e-12)
    for k in range(len(points)):
        w = weight[k]
        if w > 0 and np.isfinite(points[k, 0] + points[k, 1] + points[k, 2] + local[k, 0] + local[k, 1] + local[k, 2]):
            for i in range(3):
                for j in range(3):
                    moment[i, j] += w * (points[k, i] - here[i]) * (local[k, j] - there[j])
    return count


@compiled
def _orthonormalise(first: FloatArray, second: FloatArray) -> None:
    """Make two vectors (3,) unit vectors normal to each other, in place; the first keeps its direction."""
    first /= np.sqrt(first[0] ** 2 + first[1] ** 2 + first[2] ** 2)
    second -= (first[0] * second[0] + first[1] * second[1] + first[2] * second[2]) * first
    second /= np.sqrt(second[0] ** 2 + second[1] ** 2 + second[2] ** 2)


@compiled
def _principal_axes(moment: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the eigenvalues of MᵀM (3,), the largest first, and its eigenvectors in columns (Jacobi's rotations)."""
    square, axes = np.zeros((3, 3)), np.eye(3)
    for k in range(3):
        for i in range(3):
            for j in range(3):
                square[i, j] += moment[k, i] * moment[k, j]
    size = square[0, 0] + square[1, 1] + square[2, 2]
    for _ in range(_SWEEPS):
        if abs(square[0, 1]) + abs(square[0, 2]) + abs(square[1, 2]) <= 1e-17 * size:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if square[p, q] != 0.0:
                    _rotate(square, axes, p, q)
    values, order = np.array([square[0, 0], square[1, 1], square[2, 2]]), np.arange(3)
    for p, q in ((0, 1), (1, 2), (0, 1)):
        if values[order[p]] < values[order[q]]:
            order[p], order[q] = order[q], order[p]
    return values[order], axes[:, order]


@compiled
def _rotate(square: FloatArray, axes: FloatArray, p: int, q: int) -> None:
    """Rotate a symmetric matrix (3, 3) and its axes, in place, so that the element (p, q) becomes 0."""
    ratio = (square[q, q] - square[p, p]) / (2 * square[p, q])
    tangent = (1.0 if ratio >= 0 else -1.0) / (abs(ratio) + np.sqrt(ratio**2 + 1))
    cosine = 1 / np.sqrt(tangent**2 + 1)
    sine = tangent * cosine
    for i in range(3):
        square[i, p], square[i, q] = (
            cosine * square[i, p] - sine * square[i, q],
            sine * square[i, p] + cosine * square[i, q],
        )
    for i in range(3):
        square[p, i], square[q, i] = (
            cosine * square[p, i] - sine * square[q, i],
            sine * square[p, i] + cosine * square[q, i],
        )
        axes[i, p], axes[i, q] = cosine * axes[i, p] - sine * axes[i, q], sine * axes[i, p] + cosine * axes[i, q]


@compiled
def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


LEAST = 3
"""Fewest markers of a body that has a rotation."""

NARROW = 0.01
"""Least width of a body, m; skin motion rotates a narrower body more than a joint does."""

_RIDGE = 1e-4  # selects, of the many common points of a hinge, the point nearest to the markers
_FEWEST = 10  # fewest frames in which both bodies of a joint are visible
_ROUGH = 2  # iterations of a shape; enough to compare groups of markers
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
    shape = fit_shape(points[:, markers], iterations=_ROUGH)
    rotation, origin, _ = rigid_poses(points[:, markers], shape)
    back = (points - origin[:, None]) @ rotation
    off, _, counts = subtract_means(back)

    # The pose of a body absorbs the part H (3, 3) of a marker's error. From the pose of the other markers, the residual
    # is (I - H)⁻¹ times as large. The factor is limited in directions that the other markers hardly determine (with
    # three markers, there is one such direction).
    seen: BoolArray = np.asarray(np.isfinite(shape).all(axis=1))
    centred = np.where(seen[:, None], shape, 0.0)
    inertia = np.sum(centred**2) * np.eye(3) - centred.T @ centred
    cross = so3.hat(centred)
    turned = cross @ np.linalg.pinv(inertia, rcond=1e-6) @ cross.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(np.eye(3) - (np.eye(3) / max(int(seen.sum()), 1) + turned))
    factors = np.asarray((vectors / np.maximum(values, _FREE)[:, None, :]) @ vectors.transpose(0, 2, 1))
    for factor, marker in zip(factors, markers, strict=True):
        off[:, marker] = off[:, marker] @ factor
    square = np.einsum("fmi,fmi->m", off, off) / np.maximum(counts, 1)
    residual = np.where(counts >= max(3, 0.02 * len(points)), np.sqrt(square), np.inf)
    known = shape[seen]
    width = float(np.linalg.svd(known, compute_uv=False)[1] / np.sqrt(len(known))) if len(known) >= LEAST else 0.0
    return SpatialBody(markers, rotation, origin, residual, width)


def subtract_means(local: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return trajectories (F, k, 3) minus means (0 where missing), the means, and numbers of visible frames (k,)."""
    seen = np.isfinite(local[..., 0])
    counts = np.asarray(seen.sum(axis=0))
    mean = np.where(seen[..., None], local, 0.0).sum(axis=0) / np.maximum(counts, 1)[:, None]
    return np.where(seen[..., None], local - mean, 0.0), mean, counts


class SpatialBodies:
    """Rigid bodies of some markers (columns), and ways to divide the markers into bodies. Fits are cached.

    The trajectories ``points`` (F, M, 3) are in m, NaN where missing.
    """

    def __init__(self, points: FloatArray, markers: IntArray, constraints: Constraints) -> None:
        self.points, self.markers, self.constraints = points, markers, constraints
        self._bodies: dict[bytes, SpatialBody] = {}
        self._joints: dict[bytes, SpatialPairJoint] = {}
        self._spread = np.full((points.shape[1],) * 2, np.nan)
        variance = constraints.constrained_variance(distance_deviation(points[:, markers]) ** 2, markers)
        self._spread[np.ix_(markers, markers)] = np.sqrt(variance)

    def body(self, markers: IntArray) -> SpatialBody:
        """Return the rigid body of some markers."""
        key = markers.tobytes()
        if key not in self._bodies:
            self._bodies[key] = fit_spatial_body(self.points, markers)
        return self._bodies[key]

    def joint(self, first: SpatialBody, second: SpatialBody) -> SpatialPairJoint:
        """Return the joint between two bodies of these markers."""
        key = first.markers.tobytes() + b"|" + second.markers.tobytes()
        if key not in self._joints:
            self._joints[key] = fit_pair_joint(first, second)
        return self._joints[key]

    def joints(self, bodies: Sequence[SpatialBody]) -> dict[tuple[int, int], SpatialPairJoint]:
        """Return the joint of each pair of bodies, by their numbers i < j."""
        return {(i, j): self.joint(bodies[i], bodies[j]) for i, j in combinations(range(len(bodies)), 2)}

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
        tree = linkage(squareform(spread, checks=False), "average")
        labels = [fcluster(tree, count, "maxclust") for count in _CLUSTERS]
        starts = [each == label for each in labels for label in np.unique(each)]
        if len(spread) <= _FEW:
            starts += [np.isin(np.arange(len(spread)), order[:LEAST]) for order in np.argsort(spread, axis=1)]
        pairs: dict[bytes, tuple[SpatialBody, SpatialBody]] = {}
        for inside in {group.tobytes(): group for group in starts}.values():
            groups = [markers[inside], markers[~inside]]
            if min(map(len, groups)) < LEAST:
                continue
            for bodies in (self.reassign_markers(groups), tuple(map(self.body, groups))):
                complete = len(bodies) == 2 and sum(len(body.markers) for body in bodies) == len(markers)
                if complete and min(body.width for body in bodies) >= NARROW:
                    first, second = sorted(bodies, key=lambda body: int(body.markers[0]))
                    pairs[first.markers.tobytes()] = first, second
        return list(pairs.values())


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

    @property
    def ratio(self) -> float:
        """Motion without the joint, divided by the residual of the joint."""
        return self.free / max(self.residual, 1e-6)


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
    vector = so3.log(mean_rotation(turn).T @ turn)
    _, axes = np.linalg.eigh(vector.T @ vector)
    arc = measure_range(vector @ axes[:, 2])
    return SpatialPairJoint(solution[:3], solution[3:], _rms(np.linalg.norm(off, axis=1)), free, arc)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


_REGRESSION_RIDGE = 1e-3  # ridge of the regression, whose terms have unit variance
_TURNS = 0.09  # rad rms; smaller rotations are not used, because an undetected joint in the body also causes them
_OWN_FLOOR = 0.5e-3  # m; smaller unexplained motion changes no gain and no cost


def unexplained_motion(
    points: FloatArray, body: SpatialBody, neighbours: Sequence[SpatialBody]
) -> tuple[FloatArray, FloatArray]:
    """Return the motion of a body's markers in its frame that rotations relative to its neighbours do not explain.

    The motion (F, k, 3), m, is 0 where missing; the mean position (k, 3) of each marker, m, is also returned. The
    motion is regressed on the components of each rotation vector relative to a neighbour, and on their products.
    Neighbours are bodies that joints connect with the body. Trajectories (F, M, 3) are in the lab, m.
    """
    off, shape, _ = subtract_means(body.local(points[:, body.markers]))
    columns = [np.ones((len(off), 1))]
    for other in neighbours:
        # components of the rotation vector along its principal axes, small ones set to 0, and their products, with
        # unit variance
        turn = np.swapaxes(other.rotation, 1, 2) @ body.rotation
        here: BoolArray = np.asarray(np.isfinite(turn[:, 0, 0]))
        posture = np.full((len(turn), 9), np.nan)
        if here.any():
            vector = so3.log(mean_rotation(turn[here]).T @ turn[here])
            vector = vector @ np.linalg.eigh(np.cov(vector.T))[1]
            spread = vector.std(axis=0)
            vector = np.where(spread >= _TURNS, vector / np.maximum(spread, _TURNS), 0.0)
            first, second = np.triu_indices(3)
            posture[here] = np.concatenate([vector, vector[:, first] * vector[:, second]], axis=1)
            posture[here] -= posture[here].mean(axis=0)
        columns.append(posture)
    terms = np.concatenate(columns, axis=1)
    known: BoolArray = np.asarray(np.isfinite(terms).all(axis=1))
    seen = np.isfinite(points[:, body.markers, 0]) & known[:, None]
    motion = np.zeros_like(off)
    counts, size = seen.sum(axis=0), terms.shape[1]
    penalty = _REGRESSION_RIDGE * np.diag([0.0, *np.ones(size - 1)])
    enough = np.flatnonzero(counts > size)
    if enough.size:
        given = np.where(known[:, None], terms, 0.0)
        weight, moved = seen[:, enough].T.astype(np.float64), np.where(seen[..., None], off, 0.0)[:, enough]
        products = (given[:, :, None] * given[:, None]).reshape(len(given), -1)
        normal = (weight @ products).reshape(-1, size, size) + counts[enough, None, None] * penalty
        explained = np.linalg.solve(
            normal, np.swapaxes((given.T @ moved.reshape(len(moved), -1)).reshape(size, -1, 3), 0, 1)
        )
        motion[:, enough] = np.where(seen[:, enough, None], moved - np.swapaxes(given @ explained, 0, 1), 0.0)
    return motion, shape


def gain_of_parts(motion: FloatArray, shape: FloatArray, parts: Sequence[IntArray]) -> float:
    """Return the sum over all markers of log(residual with one common rigid motion / residual with one each).

    All motions are small. "One each" is one motion for each of the ``parts``, which are arrays of marker indices.
    ``motion`` and ``shape`` are results of :func:`unexplained_motion`.
    """
    together = _without_pose(motion, shape)
    apart = np.empty_like(together)
    for part in parts:
        apart[part] = _without_pose(motion[:, part], shape[part])
    return float(np.sum(np.log((together**2 + _OWN_FLOOR**2) / (apart**2 + _OWN_FLOOR**2))) / 2)


def unexplained_distance_sd(motion: FloatArray, shape: FloatArray) -> FloatArray:
    """Return the standard deviation (k, k) of mutual distances by the motion of :func:`unexplained_motion`, m."""
    along = shape[:, None] - shape
    along /= np.maximum(np.linalg.norm(along, axis=2), 1e-9)[..., None]
    change = np.einsum("fijc,ijc->fij", motion[:, :, None] - motion[:, None], along)
    return np.asarray(np.sqrt(np.mean(change**2, axis=0)))


def _without_pose(motion: FloatArray, shape: FloatArray) -> FloatArray:
    """Return the rms (k,) of motion (F, k, 3) without its rigid-body part (6 degrees of freedom), m."""
    count = len(shape)
    centred = shape - shape.mean(axis=0)
    pose = np.concatenate([np.tile(np.eye(3), (count, 1, 1)), so3.hat(centred)], axis=2).reshape(3 * count, 6)
    basis, _ = np.linalg.qr(pose)
    flat = motion.reshape(len(motion), 3 * count)
    left = flat - (flat @ basis) @ basis.T
    square = np.sum(left.reshape(motion.shape) ** 2, axis=(0, 2))
    freedom = 3 * max(count, LEAST)
    seen = np.maximum(np.any(motion != 0, axis=2).sum(axis=0), 1)
    return np.asarray(np.sqrt(square / seen * freedom / (freedom - 6)))


_GAIN_END = 0.7  # least summed log gain to divide a body with one joint; skin alone reaches 0.5
_GAIN_BETWEEN = 1.15  # the same between two joints, whose rotations explain less; skin alone reaches 1.1

_FAR_BETTER = float(np.log(3.5))  # mean log gain per marker, larger than by skin
_RIGID = 1.2e-3  # m; residual of a body without a joint; a joint with 2° of rotation leaves more
_NEARLY_RIGID = 0.01  # m; largest residual of a body with at most a small joint rotation
_UNKNOWN = 10.0  # m; residual on a body whose markers are on one line
_LEAST_RESIDUAL = 1e-3  # m; smaller residuals change no gain and no cost
_STAY = 0.5  # after an accepted division, a marker changes its body if its residual is reduced to this fraction
_MOST = 16  # largest number of bodies


@dataclass(frozen=True)
class Division:
    """Division of a body into two, and the evidence for it."""

    whole: SpatialBody
    parts: tuple[SpatialBody, SpatialBody]
    gain: float  # summed log gain of the markers' residuals
    evidence: float  # evidence for two bodies, relative to the required evidence: 1 or more if the bodies are real


def divide(
    sorter: SpatialBodies, start: Sequence[SpatialBody], needed: float
) -> tuple[list[SpatialBody], list[Division], list[Division]]:
    """Divide bodies, best division first, until there are 16 or no division has the evidence ``needed``.

    The results are the bodies, the accepted divisions, and the best division of every body that was not divided.
    """
    bodies = list(start)
    made: list[Division] = []
    tried: dict[bytes, Division | None] = {}
    while True:
        edges = spanning_tree(sorter.joints(bodies), len(bodies))
        known = []
        for index, whole in enumerate(bodies):
            if whole.rms_residual <= _RIGID:
                continue
            neighbours = [bodies[j if i == index else i] for i, j in edges if index in (i, j)]
            key = b"|".join(body.markers.tobytes() for body in (whole, *neighbours))
            if key not in tried:
                motion, shape = unexplained_motion(sorter.points, whole, neighbours)
                least = _GAIN_BETWEEN if len(neighbours) > 1 else _GAIN_END
                nearly_rigid = neighbours and whole.rms_residual <= _NEARLY_RIGID
                deviation = unexplained_distance_sd(motion, shape) if nearly_rigid else None
                divisions = []
                for parts in sorter.divisions(whole.markers, deviation):
                    gain = 0.0
                    for part in parts:
                        before, after = (np.minimum(body.residual[part.markers], _UNKNOWN) for body in (whole, part))
                        ratio = (before**2 + _LEAST_RESIDUAL**2) / (after**2 + _LEAST_RESIDUAL**2)
                        gain += float(np.sum(np.log(ratio)) / 2)
                    rows = [np.searchsorted(whole.markers, part.markers) for part in parts]
                    own = gain_of_parts(motion, shape, rows) if neighbours else gain  # not explained by the neighbours
                    evidence = max(own / least, gain / len(whole.markers) / _FAR_BETTER)
                    divisions.append(Division(whole, parts, gain, evidence))
                tried[key] = max(divisions, key=lambda division: division.evidence, default=None)
            if (division := tried[key]) is not None:
                known.append(division)
        best = max(known, key=lambda division: (division.evidence >= needed, division.gain), default=None)
        if best is None or best.evidence < needed or len(bodies) >= _MOST:
            return bodies, made, known
        made.append(best)
        divided = [body.markers for body in bodies if body is not best.whole]
        divided += [part.markers for part in best.parts]
        settled = sorter.reassign_markers(divided, _STAY)
        bodies = [sorter.body(group) for group in divided] if len(settled) < len(divided) else list(settled)


def spanning_tree(joints: dict[tuple[int, int], SpatialPairJoint], count: int) -> list[tuple[int, int]]:
    """Return the pairs of bodies that form the tree with the smallest joint residuals (Kruskal's algorithm)."""
    group = list(range(count))
    edges = []
    for first, second in sorted(joints, key=lambda pair: joints[pair].residual):
        if group[first] != group[second] and np.isfinite(joints[first, second].residual):
            edges.append((first, second))
            group = [group[first] if each == group[second] else each for each in group]
    return edges


_MARGIN = 0.3  # least gain in summed log residual
_FAR = 4.0  # largest ratio of residuals on the other body and on its own for a marker that may be exchanged
_CLOSE = 0.012  # m; a marker with a smaller residual on the other body may also be exchanged
_NEAR_JOINT = 0.06  # m; distance from the joint within which a marker fits both bodies
_LANDMARK = 3.0  # penalty for reassigning a single marker near the joint
_SMALL = 0.02  # m; relative motion of two bodies below which their markers are divided again
_HOPELESS = 2.0  # largest increase of the plain cost for which the cost of the unexplained motion is computed
_ROUNDS = 3

_Pair: TypeAlias = tuple[SpatialBody, SpatialBody]


def exchange_markers(sorter: SpatialBodies, start: Sequence[SpatialBody]) -> list[SpatialBody]:
    """Return the bodies of a division after neighbours have exchanged one or two markers at a time.

    An exchange is made if it reduces the summed log residual of two bodies: that of all motion, plus that of the motion
    that their neighbours do not explain.
    """
    bodies, constraints = list(start), sorter.constraints
    edges = spanning_tree(sorter.joints(bodies), len(bodies))
    costs: dict[bytes, float] = {}

    def plain_cost(pair: _Pair) -> float:
        residual = np.concatenate([body.residual[body.markers] for body in pair])
        return float(np.sum(np.log(np.minimum(residual, _UNKNOWN) ** 2 + _LEAST_RESIDUAL**2))) / 2

    def own_cost(pair: _Pair, i: int, j: int) -> float:
        at = {i: pair[0], j: pair[1]}
        total = 0.0
        for k, body in at.items():
            others = [b if a == k else a for a, b in edges if k in (a, b)]
            around = [at.get(other, bodies[other]) for other in others]
            key = b"|".join(each.markers.tobytes() for each in (body, *around))
            if key not in costs:
                left = _without_pose(*unexplained_motion(sorter.points, body, around))
                costs[key] = float(np.sum(np.log(left**2 + _OWN_FLOOR**2))) / 2
            total += costs[key]
        return total

    def is_possible(first: IntArray, second: IntArray) -> bool:
        apart = np.isin(constraints.unit[first], constraints.unit[second]).any()
        return not apart and min(len(first), len(second)) >= LEAST and all(map(constraints.allow, (first, second)))

    def propose_exchanges(first: SpatialBody, second: SpatialBody) -> Iterator[tuple[_Pair, float]]:
        """Yield both bodies after one marker, or one of each, has changed its body, and the penalty for this."""
        joint = sorter.joint(first, second)
        sides: list[list[tuple[int, float]]] = []  # markers that also fit the other body roughly, and their penalties
        for body, other, centre in ((first, second, joint.in_first), (second, first, joint.in_second)):
            close = other.residual[body.markers] <= np.maximum(_FAR * body.residual[body.markers], _CLOSE)
            movable = body.markers[close]
            _, place, _ = subtract_means(body.local(sorter.points[:, movable]))
            near = np.linalg.norm(place - centre, axis=1) <= _NEAR_JOINT
            sides.append([(int(m), _LANDMARK if each else 0.0) for m, each in zip(movable, near, strict=True)])
        leaving, joining = sides
        moves: list[tuple[list[int], list[int], float]] = [([m], [], doubt) for m, doubt in leaving]
        moves += [([], [m], doubt) for m, doubt in joining]
        moves += [([m], [k], 0.0) for m, _ in leaving for k, _ in joining]
        for out, back, doubt in moves:
            markers = [
                np.sort(np.append(np.setdiff1d(body.markers, gone), come).astype(np.int64))
                for body, gone, come in ((first, out, back), (second, back, out))
            ]
            if is_possible(*markers):
                made = sorter.body(markers[0]), sorter.body(markers[1])
                if min(body.width for body in made) >= NARROW:
                    yield made, doubt

    for _ in range(_ROUNDS):
        improved = False
        for i, j in edges:
            before = bodies[i]
            new = sorter.joint(bodies[i], bodies[j]).free < _SMALL
            for _ in range(_ROUNDS):
                pair: _Pair = bodies[i], bodies[j]
                plain, own = plain_cost(pair), own_cost(pair, i, j)
                best, chosen = plain + own - _MARGIN, pair
                choices = list(propose_exchanges(*pair))
                if new:  # other divisions of the markers of both bodies, in both orders
                    together = np.sort(np.concatenate([body.markers for body in pair]))
                    for one, other in sorter.divisions(together):
                        if is_possible(one.markers, other.markers):
                            choices += [((one, other), 0.0), ((other, one), 0.0)]
                for choice, doubt in choices:
                    rigid = plain_cost(choice) + doubt
                    if rigid > plain + _HOPELESS:
                        continue
                    cost = rigid + own_cost(choice, i, j)
                    if cost < best:
                        best, chosen = cost, choice
                if chosen is pair:
                    break
                bodies[i], bodies[j] = chosen
                new = False
            improved |= bodies[i] is not before
        if not improved:
            break
    return bodies
