"""Reachable workspace of a chain's tip within joint limits, and the overlay of two workspaces (thesis 7.2).

W = {g(θ) : θ ∈ Q} (eq. 7.1) for the box Q of the joint limits. It is the alpha shape of the points to which
low-discrepancy samples of Q are mapped: the simplices of scipy's Delaunay triangulation whose circumscribed ball has at
most a given radius. The radius follows from the samples. A circumscribed ball contains no sample; if its centre is in
the sampled set, it is therefore at most as large as the largest ball in that set without a sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, product
from math import factorial
from typing import TypeAlias

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from mocap_id.arrays import NORMAL_95, BoolArray, FloatArray, IntArray, sobol
from mocap_id.geometry import Chain, se3
from mocap_id.geometry.planar import rotate, segment_poses


@dataclass(frozen=True)
class PlanarArm:
    """A planar chain of n revolute joints with a point on its last segment: the tip."""

    centres: FloatArray  # (n, 2) centre of each joint in the coordinate frame of the previous segment, m
    tip: FloatArray  # (2,) position of the tip in the frame of the last segment, m
    centre_covariance: FloatArray  # (n, 2, 2) covariance of each centre, m²
    tip_covariance: FloatArray  # (2, 2) covariance of the tip, m²

    @classmethod
    def exact(cls, centres: FloatArray, tip: FloatArray) -> PlanarArm:
        """Return an arm with exact dimensions."""
        return cls(centres, tip, np.zeros((len(centres), 2, 2)), np.zeros((2, 2)))

    @property
    def base(self) -> FloatArray:
        """Position (2,) of the first joint, m."""
        return np.asarray(self.centres[0])

    @property
    def joints(self) -> int:
        """Number of joint angles n."""
        return len(self.centres)

    @property
    def dimension(self) -> int:
        """Dimension of the space in which the tip moves."""
        return 2

    def tips(self, q: FloatArray) -> FloatArray:
        """Return the positions (..., 2) of the tip, m, in postures (..., n), rad (eq. 3.18)."""
        angle, origin = segment_poses(q, self.centres)
        return np.asarray(origin[..., -1, :] + rotate(angle[..., -1], self.tip))

    def perturbed_pairs(self) -> list[tuple[PlanarArm, PlanarArm]]:
        """Return two arms for each uncertain dimension, which is one standard deviation larger or smaller in them.

        Centres and tip are displaced along the principal axes of their covariances. The first centre is not displaced,
        because it only moves the whole workspace.
        """
        pairs: list[tuple[PlanarArm, PlanarArm]] = []
        for j in range(1, len(self.centres)):
            for step in _principal_axes(self.centre_covariance[j]):
                moved = np.zeros_like(self.centres)
                moved[j] = step
                pairs.append((replace(self, centres=self.centres + moved), replace(self, centres=self.centres - moved)))
        tips = ((self.tip + step, self.tip - step) for step in _principal_axes(self.tip_covariance))
        pairs.extend((replace(self, tip=above), replace(self, tip=below)) for above, below in tips)
        return pairs


@dataclass(frozen=True)
class SpatialArm:
    """A chain in space with exact dimensions and a point on its last link: the tip."""

    chain: Chain
    tip: FloatArray  # (3,) position of the tip in the frame of the last link, m

    @property
    def base(self) -> FloatArray:
        """Position (3,) of the first joint, m."""
        return np.asarray(self.chain.placements[0][:3, 3])

    @property
    def joints(self) -> int:
        """Number of joint angles n."""
        return self.chain.dimension

    @property
    def dimension(self) -> int:
        """Dimension of the space in which the tip moves."""
        return 3

    def tips(self, q: FloatArray) -> FloatArray:
        """Return the positions (..., 3) of the tip in the world frame, m, in postures (..., n), rad (eq. 2.37)."""
        point = np.broadcast_to(self.tip, (*q.shape[:-1], 3))
        relative = self.chain.relative_poses(q)
        for i in reversed(range(len(self.chain.joints))):
            point = se3.act(relative[..., i, :, :], point)
        return point

    def perturbed_pairs(self) -> list[tuple[SpatialArm, SpatialArm]]:
        """Return no arms, because the dimensions are exact."""
        return []


Arm: TypeAlias = PlanarArm | SpatialArm
"""A chain with a tip, in the plane or in space."""


def _principal_axes(covariance: FloatArray) -> FloatArray:
    """Return the principal axes (K, 2) with positive variance; the length of each is its standard deviation."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 0
    return np.asarray((vectors[:, kept] * np.sqrt(values[kept])).T)


@dataclass(frozen=True)
class JointLimits:
    """The box of postures, Q of eq. 7.1; standard deviations are 0 for given limits.

    ValueError is raised if a limit is not finite, or a lower limit is not below the upper one.
    """

    lower: FloatArray  # (n,) rad
    upper: FloatArray  # (n,) rad
    lower_sd: FloatArray  # (n,) standard deviations of the lower limits, rad
    upper_sd: FloatArray  # (n,) standard deviations of the upper limits, rad

    def __post_init__(self) -> None:
        for j, (low, high) in enumerate(zip(self.lower, self.upper, strict=True), start=1):
            if not (np.isfinite(low) and np.isfinite(high)):
                raise ValueError(f"a limit of joint {j} is not finite; expected a lower and an upper limit")
            if low >= high:
                raise ValueError(
                    f"the limits of joint {j} are crossed: {np.degrees(low):.1f}° is not below {np.degrees(high):.1f}°"
                )

    @classmethod
    def given(cls, lower: FloatArray, upper: FloatArray) -> JointLimits:
        """Return joint limits (n,) without uncertainty, rad."""
        return cls(lower, upper, np.zeros_like(lower), np.zeros_like(upper))

    @property
    def dimension(self) -> int:
        """Number of joints n."""
        return len(self.lower)


def find_limits(q: FloatArray, sd: FloatArray, measured: BoolArray, quantile: float = 0.0) -> JointLimits:
    """Return the extremes of an observed motion as limits.

    ``q`` (T, n) are the angles and ``sd`` (T, n) their standard deviations, rad. Only samples that markers determine
    are used; ``measured`` (T, n) marks them. ``quantile``, below 0.5, is the fraction of each joint's samples that is
    left out at either end. The standard deviation of a limit is that of the angle at the extreme sample, or with a
    quantile the root mean square over the samples between 0.5 and 1.5 times the quantile.

    ValueError is raised if a joint was never measured, or did not move.
    """
    if not 0.0 <= quantile < 0.5:
        raise ValueError(f"the quantile is {quantile}; expected at least 0 and below 0.5")
    ends = np.empty((2, q.shape[1]))
    ends_sd = np.empty_like(ends)
    for j in range(q.shape[1]):
        usable = measured[:, j] & np.isfinite(q[:, j])
        if not usable.any():
            raise ValueError(f"joint {j + 1} was not measured in any frame, so its limits cannot be determined")
        order = np.argsort(q[usable, j])
        angle, angle_sd = q[usable, j][order], sd[usable, j][order]
        ends[0, j], ends_sd[0, j] = _lower_end(angle, angle_sd, quantile)
        ends[1, j], ends_sd[1, j] = _lower_end(angle[::-1], angle_sd[::-1], quantile)
    return JointLimits(ends[0], ends[1], ends_sd[0], ends_sd[1])


def _lower_end(values: FloatArray, sd: FloatArray, quantile: float) -> tuple[float, float]:
    """Return the limit at the beginning of sorted values (T,), and its standard deviation."""
    at = quantile * (len(values) - 1)
    below = int(at)
    above = min(below + 1, len(values) - 1)
    limit = values[below] + (at - below) * (values[above] - values[below])
    around = sd[int(0.5 * at) : int(1.5 * at) + 1]
    return float(limit), float(np.sqrt(np.mean(around**2)))


ON_FACES = 5
"""One of this number of samples is on a face of the box."""


def sample_box(lower: FloatArray, upper: FloatArray, count: int, seed: int, onto: int) -> FloatArray:
    """Return low-discrepancy samples (count, n) of a box and its faces.

    The samples are later mapped to a space with ``onto`` dimensions. The edge of the result comes from folds of the map
    and from faces of the box with at least ``onto - 1`` dimensions. Inner samples accumulate at folds, but are almost
    never on a face. Therefore one of :data:`ON_FACES` samples is on a face, with the same number on each face. For any
    N, the first N samples have the same distribution.
    """
    n = len(lower)
    faces = [  # joints at a limit, and the limit of each (0 or 1)
        (fixed, sides)
        for count_fixed in range(1, n - max(onto - 1, 0) + 1)
        for fixed in combinations(range(n), count_fixed)
        for sides in product((0.0, 1.0), repeat=count_fixed)
    ]
    unit = np.empty((count, n))
    on_face = (np.arange(count) % ON_FACES == ON_FACES - 1) & bool(faces)  # one joint alone has no such face
    unit[~on_face] = sobol(int((~on_face).sum()), n, seed)
    face_rows = np.flatnonzero(on_face)
    for k, (joints, sides) in enumerate(faces):  # one sequence for each, because part of a sequence is not even
        rows = face_rows[k :: len(faces)]
        unit[rows] = sobol(len(rows), n, seed + 1 + k)
        for joint, side in zip(joints, sides, strict=True):
            unit[rows, joint] = side
    return np.asarray((1 - unit) * lower + unit * upper)


RADIUS_FACTOR = 2.0
"""Radius of the alpha shape, relative to the largest hole among the samples; holes up to this size are filled."""


@dataclass(frozen=True)
class AlphaShape:
    """A union of simplices."""

    points: FloatArray  # (N, d) m; d is 2 or 3
    triangulation: Delaunay  # triangulation of the points
    kept: BoolArray  # (K,) whether each simplex of the triangulation belongs to the shape
    radius: float  # largest allowed circumscribed radius, m

    @property
    def measure(self) -> float:
        """Area, m², or volume, m³."""
        return float(np.abs(_signed_measure(self.points[self.triangulation.simplices[self.kept]])).sum())

    def boundary(self) -> IntArray:
        """Return the facets of the shape's boundary, (F, d) indices.

        The facets are oriented as :func:`compute_measure` requires: outside to the right (d = 2), or outwards (d = 3).
        """
        simplices, d = self.triangulation.simplices, self.points.shape[1]
        facets = []
        for corner in range(d + 1):
            neighbour = self.triangulation.neighbors[:, corner]
            edge = self.kept & ((neighbour < 0) | ~self.kept[neighbour])
            facet = np.delete(simplices[edge], corner, axis=1)
            inner = self.points[simplices[edge, corner]]
            inwards = _signed_measure(np.concatenate([self.points[facet], inner[:, None]], axis=1)) > 0
            facet[~inwards, :2] = facet[~inwards, 1::-1]
            facets.append(facet)
        return np.concatenate(facets).astype(np.int64)

    def contains(self, points: FloatArray) -> BoolArray:
        """Return whether each of the points (M, d) is in the shape."""
        simplex = self.triangulation.find_simplex(points)
        return np.asarray((simplex >= 0) & self.kept[simplex])


def compute_alpha_shape(points: FloatArray, radius: float) -> AlphaShape:
    """Return the alpha shape of points (N, d), d = 2 or 3, for a radius, m.

    ValueError is raised if there are fewer than d + 1 points, or all of them are on one line (or in one plane).
    """
    spread = points - points.mean(axis=0)
    d = points.shape[1]
    if len(points) <= d or np.linalg.matrix_rank(spread, tol=1e-9 * max(np.abs(spread).max(), 1e-300)) < d:
        raise ValueError(f"the {len(points)} points have no {'area' if d == 2 else 'volume'}")
    triangulation = Delaunay(points)
    return AlphaShape(points, triangulation, _is_kept(points, triangulation, radius), radius)


def compute_measure(corners: FloatArray) -> FloatArray:
    """Return the area or volume (...) within a closed, oriented boundary, by the divergence theorem.

    ``corners`` (..., F, d, d) are the coordinates of the corners of all facets. The measure is the sum of their
    determinants, divided by d!, with the opposite sign in space.
    """
    d = corners.shape[-1]
    sign = 1.0 if d == 2 else -1.0  # the apex comes last, behind d - 1 swaps
    return np.asarray(sign * np.linalg.det(corners).sum(axis=-1) / factorial(d))


def _signed_measure(corners: FloatArray) -> FloatArray:
    """Return the signed area or volume (K,) of simplices (K, d + 1, d)."""
    edges = corners[:, 1:] - corners[:, :1]
    return np.asarray(np.linalg.det(edges) / factorial(corners.shape[-1]))


def _is_kept(points: FloatArray, triangulation: Delaunay, radius: float) -> BoolArray:
    """Return whether the circumscribed ball of each simplex has at most the radius, m; not for a degenerate simplex."""
    corners = points[triangulation.simplices]  # (K, d + 1, d)
    edges = corners[:, 1:] - corners[:, :1]
    square = np.sum(edges**2, axis=-1)
    volume = np.abs(np.linalg.det(edges))
    flat = volume <= 1e-14 * np.prod(np.sqrt(square), axis=-1)
    edges[flat] = np.eye(corners.shape[-1])
    centre = np.linalg.solve(edges, 0.5 * square[..., None])[..., 0]
    return np.where(flat, np.inf, np.linalg.norm(centre, axis=-1)) <= radius


POSTURES = 10_000
"""Default number of postures, as in the thesis."""


_PARTS = (8, 4, 2, 1)  # divisors of the number of samples, to measure the convergence
_LEAST = 64  # least number of samples for a useful shape
_OVERLAY_POINTS = 1 << 16


@dataclass(frozen=True)
class ReachableWorkspace:
    """A reachable workspace."""

    shape: AlphaShape  # shape of the reached points, m
    postures: FloatArray  # (N, n) postures that reach these points, rad
    measure: float  # area, m², or volume, m³
    interval: tuple[float, float]  # 95 % interval of the measure
    sd: float  # standard deviation of the measure, from the uncertain limits and dimensions
    discretisation: float  # bound of the error from the number of samples (`_bound_discretisation`)
    convergence: tuple[tuple[int, float, float], ...]  # samples, radius and measure of each fraction
    seed: int  # of the samples


def compute_reachable_workspace(
    arm: Arm, limits: JointLimits, samples: int = POSTURES, seed: int = 0
) -> ReachableWorkspace:
    """Return the reachable workspace of an arm within joint limits.

    The radius of the alpha shape is :data:`RADIUS_FACTOR` times the largest distance
    between the tip in an equal number of other postures and the nearest sample. The interval is 1.96 standard
    deviations, widened on both sides by the discretisation. The standard deviation follows from displacing each limit
    and dimension in turn by its standard deviation; the topology of the edge stays the same.

    ValueError is raised if there are fewer than 512 samples, the number of limits differs from the number of joints, or
    the points of the tip have no area (or volume).
    """
    if samples < _LEAST * max(_PARTS):
        raise ValueError(
            f"{samples} samples are too few to measure the convergence; expected at least {_LEAST * max(_PARTS)}"
        )
    if limits.dimension != arm.joints:
        raise ValueError(f"there are limits for {limits.dimension} joints; expected {arm.joints}, as in the chain")
    postures = sample_box(limits.lower, limits.upper, samples, seed, arm.dimension)
    points = arm.tips(postures)
    others = arm.tips(limits.lower + sobol(samples, arm.joints, seed + 1000) * (limits.upper - limits.lower))
    shapes = []
    for part in _PARTS:
        some, checked = points[: samples // part], others[: samples // part]
        shapes.append(compute_alpha_shape(some, RADIUS_FACTOR * float(np.max(cKDTree(some).query(checked)[0]))))
    measures = [shape.measure for shape in shapes]
    discretisation = _bound_discretisation(shapes)
    sd = _measure_sd(arm, limits, postures, shapes[-1])
    reach = NORMAL_95 * sd + discretisation
    return ReachableWorkspace(
        shape=shapes[-1],
        postures=postures,
        measure=measures[-1],
        interval=(max(measures[-1] - reach, 0.0), measures[-1] + reach),
        sd=sd,
        discretisation=discretisation,
        convergence=tuple(
            (len(shape.points), shape.radius, size) for shape, size in zip(shapes, measures, strict=True)
        ),
        seed=seed,
    )


def _bound_discretisation(shapes: list[AlphaShape]) -> float:
    """Return a bound of the error from the number of samples, m² or m³; the last two shapes have a half and all.

    Chords cut off a curved edge: a half of the samples has 1.6 times the error in space, and more in the plane. The
    error is then at most 1.7 times the difference between a half and all, with the *same* radius, because a larger
    radius also fills bays and cavities. What the radius fills is added. Differences with each number's own radius are
    not enough: around a cavity both effects can cancel. They count if they are larger.
    """
    half, whole = shapes[-2:]
    kept = _is_kept(whole.points, whole.triangulation, half.radius)
    with_radius_of_half = replace(whole, kept=kept, radius=half.radius).measure
    cut_off, filled = abs(with_radius_of_half - half.measure), abs(with_radius_of_half - whole.measure)
    return max(2 * cut_off + filled, *(abs(whole.measure - fewer.measure) for fewer in shapes[:-1]))


def _measure_sd(arm: Arm, limits: JointLimits, postures: FloatArray, shape: AlphaShape) -> float:
    """Return the standard deviation of the area or volume from the uncertain joint limits and dimensions of the arm."""
    facets = shape.boundary()
    used, corner = np.unique(facets, return_inverse=True)
    share = (postures[used] - limits.lower) / (limits.upper - limits.lower)

    def measure(moved: Arm, low: FloatArray, high: FloatArray) -> float:
        points = moved.tips(limits.lower + low + share * (limits.upper + high - limits.lower - low))
        return float(compute_measure(points[corner.reshape(facets.shape)]))

    still = np.zeros(limits.dimension)
    halves = [measure(arm, step, still) - measure(arm, -step, still) for step in np.diag(limits.lower_sd)]
    halves += [measure(arm, still, step) - measure(arm, still, -step) for step in np.diag(limits.upper_sd)]
    halves += [measure(above, still, still) - measure(below, still, still) for above, below in arm.perturbed_pairs()]
    return 0.5 * float(np.linalg.norm(halves))


@dataclass(frozen=True)
class Overlay:
    """Intersection and differences of two workspaces; areas in m², or volumes in m³."""

    gained: float  # only in the later workspace
    lost: float  # only in the earlier workspace
    kept: float  # in both
    sd: float  # standard deviation of each of these areas or volumes, from the number of counted points
    points: FloatArray  # (M, d) points in any of the workspaces, in the frame of the earlier one, m
    before: BoolArray  # (M,) whether a point is in the earlier workspace
    after: BoolArray  # (M,) whether a point is in the later workspace


def overlay_workspaces(before: AlphaShape, after: AlphaShape, shift: FloatArray, seed: int = 0) -> Overlay:
    """Compare two workspaces of the same dimension.

    ``shift`` (d,) is the translation from the frame of the later workspace to the frame of the earlier one, m. The
    counted points are evenly spread over a box around both; ``seed`` is their seed.
    """
    both = np.concatenate([before.points, after.points + shift])
    low, high = both.min(axis=0), both.max(axis=0)
    points = low + sobol(_OVERLAY_POINTS, both.shape[1], seed) * (high - low)
    inside, later = before.contains(points), after.contains(points - shift)
    box = float(np.prod(high - low))
    shares = [float(np.mean(part)) for part in (later & ~inside, inside & ~later, inside & later)]
    either = inside | later
    return Overlay(
        gained=shares[0] * box,
        lost=shares[1] * box,
        kept=shares[2] * box,
        sd=box * float(np.sqrt(max(share * (1 - share) for share in shares) / _OVERLAY_POINTS)),
        points=points[either],
        before=inside[either],
        after=later[either],
    )
