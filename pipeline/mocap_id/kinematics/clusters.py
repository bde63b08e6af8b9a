"""Constraints of the user, and clusters of markers that move as one body."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.joint import PairJoint, RigidBody, fit_body, fit_joint, marker_residuals, variance_over_time


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
            residuals = np.stack([self._residuals(body) for body in bodies])
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

    def _residuals(self, body: RigidBody) -> FloatArray:
        """Return the residuals (M,) of all moving markers on a body, m."""
        key = body.markers.tobytes()
        if key not in self._off:
            self._off[key] = marker_residuals(body, self.points[:, self.moving])
        return self._off[key]
