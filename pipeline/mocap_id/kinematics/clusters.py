"""Constraints of the user, still markers, clusters of markers that move as one body, and the poses of clusters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray, chunks
from mocap_id.kinematics.bundle import frames_along_motion
from mocap_id.kinematics.joint import (
    PairJoint,
    RigidBody,
    fit_body,
    fit_joint,
    marker_residuals,
    planar_poses,
    variance_over_time,
)


@dataclass(frozen=True)
class Constraints:
    """Markers that share a segment, and pairs of markers that do not."""

    unit: IntArray  # (M,) markers with the same number are assigned together
    barred: BoolArray  # (M, M) pairs that may not share a segment; symmetric, the same for all markers of a unit

    @classmethod
    def of(cls, count: int, together: Iterable[Sequence[int]] = (), apart: Iterable[Sequence[int]] = ()) -> Constraints:
        """Return constraints on ``count`` markers from groups of columns: ``together`` on one segment, or ``apart``."""
        unit = np.arange(count)
        for group in together:
            unit[np.isin(unit, unit[list(group)])] = unit[group[0]]
        barred = np.zeros((count, count), dtype=np.bool_)
        for group in apart:
            barred[np.ix_(list(group), list(group))] = True
        np.fill_diagonal(barred, val=False)
        same = unit[:, None] == unit
        barred = same @ barred @ same
        return cls(unit, barred)

    @property
    def contradictory(self) -> BoolArray:
        """Markers (M,) that the constraints require to be both together and apart."""
        return np.asarray(np.diagonal(self.barred))

    def allow(self, members: IntArray) -> bool:
        """Return whether the members may share a segment."""
        return not self.barred[np.ix_(members, members)].any()

    def constrained_variance(self, variance: FloatArray, members: IntArray) -> FloatArray:
        """Return variances of mutual distances (K, K), set to 0 within a unit and to a large value for barred pairs."""
        far = 10 * np.max(variance, initial=0.0) + 1.0
        shaped = np.where(self.barred[np.ix_(members, members)], far, variance)
        return np.where(self.unit[members][:, None] == self.unit[members], 0.0, shaped)

    def nearest_bodies(self, square: FloatArray, members: IntArray) -> IntArray:
        """Return the body (K,) that fits each member best. Units stay together and, if possible, barred pairs apart.

        ``square`` (B, K) is the mean squared distance of each member from its position on each of B bodies, m^2.
        """
        _, index = np.unique(self.unit[members], return_inverse=True)
        cost = np.zeros((len(square), index.max() + 1))
        np.add.at(cost.T, index, square.T)
        first = members[[int(np.argmax(index == u)) for u in range(cost.shape[1])]]
        barred = self.barred[np.ix_(first, first)]
        best = np.argmin(cost, axis=0)
        for u, v in np.argwhere(np.triu(barred)):
            if best[u] != best[v]:
                continue
            moves = []  # to the next best free body, by the unit for which this costs less
            for unit in (int(u), int(v)):
                taken = np.isin(np.arange(len(cost)), best[barred[unit]])
                elsewhere = np.where(taken, np.inf, cost[:, unit])
                body = int(np.argmin(elsewhere))
                moves.append((float(elsewhere[body] - cost[best[unit], unit]), unit, body))
            loss, unit, body = min(moves)
            if np.isfinite(loss):
                best[unit] = body
        return np.asarray(best[index])


_REASSIGNMENTS = 20
_AS_WELL = 1.2  # one body fits as well as two if the residual grows at most by this factor
_FOREIGN = 4.0  # a marker with more than this many times the median residual of its nearest body is on no body
_MIN_FOREIGN = 0.02  # m
_MOST_FOREIGN = 2
_WOBBLE = 6.0  # 2.5 to 97.5 % range of an angle of pure noise, in standard deviations, with a margin


@dataclass(frozen=True)
class Base:
    """Markers that stand still."""

    markers: IntArray  # columns of the still markers
    noise: float  # rms of one coordinate of the still markers, m
    gap: float  # scatter of the stillest moving marker divided by the largest scatter of a base marker
    scatter: FloatArray  # (M,) rms distance of every marker from its mean, m; inf if it is hardly visible


def find_base(points: ComplexArray, limit: float, constraints: Constraints) -> Base:
    """Return the base: the still markers whose scatter is below the largest jump in the sorted scatters of all markers.

    ``limit`` is the largest scatter of a still marker, m. A still marker that the user has put together with a moving
    marker is not on the base. Of two still markers that must be apart, only the stiller one is on the base.
    """
    square, counts = variance_over_time(points)
    scatter = np.where(counts >= max(2, 0.05 * len(points)), np.sqrt(square), np.inf)
    order = np.argsort(scatter)[: np.isfinite(scatter).sum()]
    floor = np.maximum(scatter[order], 1e-5)  # ratios of smaller values are rounding errors
    still = int(np.sum(scatter[order] <= limit))
    if still == 0:
        return Base(np.array([], dtype=np.int64), 0.0, 1.0, scatter)
    jumps = np.append(floor[1:], np.inf if still == len(order) else floor[-1]) / floor
    last = int(np.argmax(jumps[:still]))
    units = constraints.unit[order]
    allowed: list[int] = []
    for marker in order[: last + 1][~np.isin(units[: last + 1], units[last + 1 :])]:
        if not constraints.barred[marker, allowed].any():
            allowed.append(int(marker))
    markers = np.sort(np.array(allowed, dtype=np.int64))
    noise = float(np.median(scatter[markers]) / np.sqrt(2)) if len(markers) else 0.0
    return Base(markers, noise, float(jumps[last]), scatter)


class MarkerClusters:
    """Division of the moving markers into any number of rigid bodies. Fits are cached.

    The trajectories ``points`` (F, M) are in the plane, m, NaN where missing.
    """

    def __init__(self, points: ComplexArray, moving: IntArray, constraints: Constraints) -> None:
        self.points, self.moving, self.constraints = points, moving, constraints
        self._bodies: dict[bytes, RigidBody] = {}
        self._off: dict[bytes, FloatArray] = {}
        self._joints: dict[tuple[bytes, bytes], PairJoint] = {}
        units = constraints.unit[moving]
        self._alone = np.bincount(units)[units] == 1  # hints keep the other markers together
        # variance of mutual distances, m^2; the largest one for pairs that are never visible together
        tracks = points[:, moving]
        variance = np.zeros((len(moving), len(moving)))
        for k in range(len(moving)):
            square, counts = variance_over_time(np.abs(tracks - tracks[:, k : k + 1]))
            variance[k] = np.where(counts > 1, square, np.nan)
        variance = np.where(np.isfinite(variance), variance, np.nanmax(variance, initial=0.0))
        variance = (variance + variance.T) / 2
        np.fill_diagonal(variance, 0)
        variance = constraints.constrained_variance(variance, moving)
        self._tree = linkage(squareform(variance, checks=False), "average") if len(moving) > 1 else None

    def bodies_at(self, count: int) -> list[RigidBody]:
        """Return at most ``count`` bodies of at least two markers.

        Average linkage on the variance of mutual distances gives the first bodies. Every marker is then reassigned to
        the body that fits it best, until no marker changes its body. A marker that fits no body is left out.
        """
        if self._tree is None:
            return []
        labels = fcluster(self._tree, count, "maxclust")
        groups = [self.moving[labels == label] for label in np.unique(labels)]
        for _ in range(_REASSIGNMENTS):
            bodies = [self._fit(group) for group in groups if len(group) > 1]
            if len(bodies) < 2:
                break
            keys = [body.markers.tobytes() for body in bodies]
            for key, body in zip(keys, bodies, strict=True):
                if key not in self._off:  # residuals (M,) of all moving markers on a body, m
                    self._off[key] = marker_residuals(body, self.points[:, self.moving])
            residuals = np.stack([self._off[key] for key in keys])
            best = self.constraints.nearest_bodies(residuals**2, self.moving)
            # foreign markers fit their nearest body much worse than its typical marker does
            own = residuals[best, np.arange(len(best))]
            usual = {index: float(np.median(own[best == index])) for index in np.unique(best)}
            limit = np.maximum([_FOREIGN * usual[index] for index in best], _MIN_FOREIGN)
            foreign = (own > limit) & self._alone
            if foreign.sum() <= _MOST_FOREIGN:  # more of them are bodies that this level does not separate
                best[foreign] = -1
            regrouped = [self.moving[best == index] for index in range(len(bodies))]
            if len(regrouped) == len(groups) and all(map(np.array_equal, regrouped, groups)):
                break
            groups = regrouped
        return [self._fit(group) for group in groups if len(group) > 1]

    def merge(self, bodies: list[RigidBody], min_arc: float, tolerance: float) -> list[RigidBody]:
        """Merge bodies that one rigid body fits nearly as well as two, and return all bodies.

        Two bodies are merged if their common residual is hardly larger than their own. If their relative rotation is
        below ``min_arc``, rad, or below its noise, the common residual may be up to ``tolerance`` times their own.
        """
        bodies = list(bodies)
        while len(bodies) > 1:
            candidates = []
            for (i, first), (j, second) in combinations(enumerate(bodies), 2):
                both = self.join(first, second)
                if both is None:
                    continue
                counts = len(first.markers), len(second.markers)
                pooled = (counts[0] * first.residual**2 + counts[1] * second.residual**2) / sum(counts)
                growth = both.residual / float(max(np.sqrt(pooled), 1e-4))
                if growth > _AS_WELL:
                    noise = _WOBBLE * np.hypot(first.angle_noise, second.angle_noise)
                    if growth > tolerance or self.joint(first, second).arc >= max(min_arc, noise):
                        continue
                candidates.append((growth, i, j, both))
            if not candidates:
                break
            _, i, j, both = min(candidates, key=lambda candidate: candidate[0])
            bodies = [body for k, body in enumerate(bodies) if k not in (i, j)] + [both]
        return bodies

    def join(self, first: RigidBody, second: RigidBody) -> RigidBody | None:
        """Return two bodies as one, or None if the constraints do not allow this."""
        markers = np.sort(np.concatenate([first.markers, second.markers]))
        return self._fit(markers) if self.constraints.allow(markers) else None

    def joint(self, parent: RigidBody, child: RigidBody) -> PairJoint:
        """Return the joint between two bodies."""
        key = parent.markers.tobytes(), child.markers.tobytes()
        if key not in self._joints:
            self._joints[key] = fit_joint(parent, child)
        return self._joints[key]

    def _fit(self, markers: IntArray) -> RigidBody:
        key = markers.tobytes()
        if key not in self._bodies:
            self._bodies[key] = fit_body(self.points, markers)
        return self._bodies[key]


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

    Samples far above the usual residual ``own`` (m,), m, of their marker are left out.
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
) -> tuple[complex, complex, float] | None:
    """Return the position of the ankle between a moving foot and the shank; None with fewer than ten common frames.

    The results are the positions in the frames of foot and shank, m, and the standard deviation in one direction, m.
    The position is that of the joint fit, ``ankle`` in the foot's frame, m, if only the skin of the foot moves. Each
    body is given by the origin (F,), m, and the angle (F,), rad, of its frame, NaN where unknown.
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
    return ankle + shift, complex(beyond), float(np.sqrt(variance))


def _measure_gap(columns: ComplexArray, apart: ComplexArray) -> float:
    """Return the mean square per coordinate, m², of what ``columns`` (F, k) do not explain of a distance (F,), m."""
    return float(np.mean(np.abs(apart - columns @ np.linalg.lstsq(columns, apart)[0]) ** 2)) / 2
