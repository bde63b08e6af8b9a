"""Which markers move as one body: the fixed base and the rigid bodies above it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.constraints import Constraints
from mocap_id.kinematics.joint import PairJoint, fit_joint
from mocap_id.kinematics.rigid import Body, fit_body, marker_residuals

_REASSIGNMENTS = 20
_AS_WELL = 1.2  # one body fits as well as two if the residual grows by no more than this factor
_WOBBLE = 6.0  # standard deviations between the 2.5 and 97.5 % quantiles of an angle that is noise alone, with margin


@dataclass(frozen=True)
class Base:
    """The markers that do not move.

    Parameters
    ----------
    markers : int array
        Columns of the still markers; empty where none stands still.
    noise : float
        rms of one coordinate of the still markers, m: the noise floor.
    gap : float
        Scatter of the first moving marker over that of the last still one.
    scatter : (M,) array
        rms distance of every marker from its mean, m.
    """

    markers: IntArray
    noise: float
    gap: float
    scatter: FloatArray


def find_base(points: ComplexArray, limit: float, constraints: Constraints | None = None) -> Base:
    """Split still from moving markers at the largest jump in their scatter.

    A still marker that belongs together with a moving one is no base marker, nor is the one of two that must be apart
    which moves more.

    Parameters
    ----------
    points : (F, M) complex array
        Trajectories in the plane, m.
    limit : float
        A marker with more scatter than this (m) cannot be still.
    """
    scatter = _scatter(points)
    order = np.argsort(scatter)[: np.isfinite(scatter).sum()]
    floor = np.maximum(scatter[order], 1e-5)  # below this, ratios are those of rounding
    still = int(np.sum(scatter[order] <= limit))
    if still == 0:
        return Base(np.array([], dtype=np.int64), 0.0, 1.0, scatter)
    jumps = np.append(floor[1:], np.inf if still == len(order) else floor[-1]) / floor
    last = int(np.argmax(jumps[:still]))
    markers = _permitted(order[: last + 1], order[last + 1 :], constraints)
    noise = float(np.median(scatter[markers]) / np.sqrt(2)) if len(markers) else 0.0
    return Base(markers, noise, float(jumps[last]), scatter)


def _permitted(still: IntArray, moving: IntArray, constraints: Constraints | None) -> IntArray:
    """The still markers, given in the order of their scatter, that may be the base together."""
    if constraints is None:
        return np.sort(still)
    alone = still[~np.isin(constraints.unit[still], constraints.unit[moving])]
    kept: list[int] = []
    for marker in alone:
        if not constraints.barred[marker, kept].any():
            kept.append(int(marker))
    return np.sort(np.array(kept, dtype=np.int64))


class Clusters:
    """The moving markers sorted into rigid bodies, at any level of detail; each body and each joint is fitted once.

    Parameters
    ----------
    points : (F, M) complex array
        Trajectories in the plane, m; NaN where unseen.
    moving : int array
        Columns of the markers to sort.
    constraints : Constraints
        Which of them belong together or apart.
    """

    def __init__(self, points: ComplexArray, moving: IntArray, constraints: Constraints) -> None:
        self.points, self.moving, self.constraints = points, moving, constraints
        self._bodies: dict[bytes, Body] = {}
        self._joints: dict[tuple[bytes, bytes], PairJoint] = {}
        variance = constraints.shaped(_distance_variance(points[:, moving]), moving)
        self._tree = linkage(squareform(variance, checks=False), "average") if len(moving) > 1 else None

    def at(self, count: int) -> list[Body]:
        """At most ``count`` bodies of at least two markers.

        Average linkage on the variance of the mutual distances starts it; then every marker goes to the body that holds
        it best, until none changes.
        """
        if self._tree is None:
            return []
        labels = fcluster(self._tree, count, "maxclust")
        groups = [self.moving[labels == label] for label in np.unique(labels)]
        for _ in range(_REASSIGNMENTS):
            bodies = self._rigid(groups)
            if len(bodies) < 2:
                break
            residuals = np.stack([marker_residuals(body, self.points[:, self.moving]) for body in bodies])
            best = self.constraints.nearest(residuals**2, self.moving)
            regrouped = [self.moving[best == index] for index in range(len(bodies))]
            if len(regrouped) == len(groups) and all(map(np.array_equal, regrouped, groups)):
                break
            groups = regrouped
        return self._rigid(groups)

    def merged(self, bodies: list[Body], min_arc: float, tolerance: float) -> list[Body]:
        """Merge bodies that one rigid body fits nearly as well as two.

        Parameters
        ----------
        min_arc : float
            Bodies that turn by less (rad) against each other, or by no more than their own wobble, are one more easily.
        tolerance : float
            Such are one if the merged residual stays under this multiple of their own; others if it hardly grows at
            all.
        """
        bodies = list(bodies)
        while len(bodies) > 1:
            candidates = []
            for (i, first), (j, second) in combinations(enumerate(bodies), 2):
                both = self.joined(first, second)
                if both is None:
                    continue
                growth = both.residual / _pooled(first, second)
                if growth <= _AS_WELL or (growth <= tolerance and self._hardly_turn(first, second, min_arc)):
                    candidates.append((growth, i, j, both))
            if not candidates:
                break
            _, i, j, both = min(candidates, key=lambda candidate: candidate[0])
            bodies = [body for k, body in enumerate(bodies) if k not in (i, j)] + [both]
        return bodies

    def joined(self, first: Body, second: Body) -> Body | None:
        """Two bodies as one; None where the user wants some of their markers apart."""
        markers = np.sort(np.concatenate([first.markers, second.markers]))
        return self._fit(markers) if self.constraints.allow(markers) else None

    def joint(self, parent: Body, child: Body) -> PairJoint:
        """The joint between two bodies."""
        key = parent.markers.tobytes(), child.markers.tobytes()
        if key not in self._joints:
            self._joints[key] = fit_joint(parent, child)
        return self._joints[key]

    def _hardly_turn(self, first: Body, second: Body, min_arc: float) -> bool:
        """Whether two bodies turn against each other by less than an angle (rad) or than they wobble."""
        wobble = _WOBBLE * np.hypot(first.angle_noise, second.angle_noise)
        return bool(self.joint(first, second).arc < max(min_arc, wobble))

    def _rigid(self, groups: list[IntArray]) -> list[Body]:
        return [self._fit(group) for group in groups if len(group) > 1]

    def _fit(self, markers: IntArray) -> Body:
        key = markers.tobytes()
        if key not in self._bodies:
            self._bodies[key] = fit_body(self.points, markers)
        return self._bodies[key]


def _pooled(first: Body, second: Body) -> float:
    """rms residual of two bodies taken together, m, not below a tenth of a millimetre."""
    counts = len(first.markers), len(second.markers)
    square = (counts[0] * first.residual**2 + counts[1] * second.residual**2) / sum(counts)
    return float(max(np.sqrt(square), 1e-4))


def _scatter(points: ComplexArray) -> FloatArray:
    """(M,) rms distance of every marker from its mean, m; inf for a marker that is hardly ever seen."""
    seen = np.isfinite(points)
    counts = seen.sum(axis=0)
    filled = np.where(seen, points, 0)
    mean = filled.sum(axis=0) / np.maximum(counts, 1)
    square = np.where(seen, np.abs(filled - mean) ** 2, 0).sum(axis=0) / np.maximum(counts, 1)
    return np.where(counts >= max(2, 0.05 * len(points)), np.sqrt(square), np.inf)


def _distance_variance(points: ComplexArray) -> FloatArray:
    """(M, M) variance over time of the distance between every two markers, m^2; large for pairs never seen together."""
    count = points.shape[1]
    variance = np.zeros((count, count))
    for marker in range(count):
        distance = np.abs(points - points[:, marker : marker + 1])
        seen = np.isfinite(distance)
        counts = seen.sum(axis=0)
        filled = np.where(seen, distance, 0)
        mean = filled.sum(axis=0) / np.maximum(counts, 1)
        square = np.where(seen, (filled - mean) ** 2, 0).sum(axis=0) / np.maximum(counts, 1)
        variance[marker] = np.where(counts > 1, square, np.nan)
    variance = np.where(np.isfinite(variance), variance, np.nanmax(variance, initial=0.0))
    variance = (variance + variance.T) / 2
    np.fill_diagonal(variance, 0)
    return variance
