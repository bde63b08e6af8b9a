"""Rigid bodies in the plane, circles of markers, and the joint between two bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray

_ITERATIONS = 50
_TOLERANCE = 1e-7  # m
_SAME_PLACE = 0.03  # m


@dataclass(frozen=True)
class RigidBody:
    """Markers that move as one rigid body."""

    markers: IntArray  # (k,) columns of the trajectories
    template: ComplexArray  # (k,) marker coordinates in the body's frame, whose origin is their centroid, m
    rotation: ComplexArray  # (F,) ``exp(i phi)`` of the body; NaN with fewer than two visible markers
    position: ComplexArray  # (F,) origin of the body's frame, m
    residual: float  # rms distance of the markers from their positions on the body, m

    @property
    def angle_noise(self) -> float:
        """Standard deviation of the angle of ``rotation``, rad, if the residual were white noise.

        The pose absorbs three of a frame's 2 k coordinates, so the residual is smaller than the noise. The result is
        infinite with fewer than two markers, or if all are at one point.
        """
        spread, coordinates = float(np.sqrt(np.sum(np.abs(self.template) ** 2))), 2 * len(self.markers)
        if spread == 0 or coordinates <= 3:
            return np.inf
        return float(self.residual * np.sqrt(coordinates / (coordinates - 3) / 2) / spread)

    def local(self, points: ComplexArray) -> ComplexArray:
        """Return trajectories (F, ...) in the body's frame."""
        shape = (-1,) + (1,) * (points.ndim - 1)
        return np.asarray(np.conj(self.rotation).reshape(shape) * (points - self.position.reshape(shape)))


def fit_body(points: ComplexArray, markers: Sequence[int] | IntArray) -> RigidBody:
    """Fit a rigid body to markers by least squares (generalised Procrustes analysis over the frames, ignoring gaps).

    ``markers`` are at least two columns of the trajectories (F, M), m, NaN where missing.
    """
    columns = np.asarray(markers, dtype=np.int64)
    seen = np.isfinite(points[:, columns])
    z = np.where(seen, points[:, columns], 0)
    weight = seen.astype(np.float64)
    template = z[int(np.argmax(seen.sum(axis=1)))]
    for _ in range(_ITERATIONS):
        rotation, position = rigid_poses(z, weight, template)
        back = np.conj(rotation)
        updated = (back @ z - (back * position) @ weight) / np.maximum(weight.sum(axis=0), 1)
        updated -= updated.mean()
        moved = float(np.max(np.abs(updated - template)))
        template = updated
        if moved < _TOLERANCE:
            break
    rotation, position = rigid_poses(z, weight, template)
    enough = seen.sum(axis=1) >= 2
    off = np.abs(z - position[:, None] - rotation[:, None] * template)[seen & enough[:, None]]
    residual = float(np.sqrt(np.mean(off**2))) if off.size else np.inf
    unknown = np.where(enough, 1.0, np.nan)
    return RigidBody(columns, template, rotation * unknown, position * unknown, residual)


def still_body(points: ComplexArray, markers: Sequence[int] | IntArray) -> RigidBody:
    """Return the fixed base as a rigid body whose frame is the plane frame."""
    columns = np.asarray(markers, dtype=np.int64)
    template = np.nanmean(points[:, columns], axis=0)
    frames = len(points)
    off = np.abs(points[:, columns] - template)
    return RigidBody(
        columns,
        template,
        np.ones(frames, dtype=np.complex128),
        np.zeros(frames, dtype=np.complex128),
        float(np.sqrt(np.nanmean(off**2))),
    )


def marker_residuals(body: RigidBody, points: ComplexArray) -> FloatArray:
    """Return the rms distance (M,) of markers from their mean positions on a body, m; inf if hardly visible."""
    square, counts = variance_over_time(body.local(points))
    return np.where(counts > 1, np.sqrt(square), np.inf)


def variance_over_time(values: FloatArray | ComplexArray) -> tuple[FloatArray, IntArray]:
    """Return the variance (M,) of each column (F, M), ignoring NaN, and the number of its values (M,)."""
    seen = np.isfinite(values)
    counts = seen.sum(axis=0)
    filled = np.where(seen, values, 0)
    mean = filled.sum(axis=0) / np.maximum(counts, 1)
    return np.where(seen, np.abs(filled - mean) ** 2, 0).sum(axis=0) / np.maximum(counts, 1), counts


def count_positions(local: ComplexArray) -> int:
    """Return the number of distinct positions among ``local`` (K,), m; those within 30 mm count once."""
    kept: list[complex] = []
    for each in local:
        if all(abs(each - other) > _SAME_PLACE for other in kept):
            kept.append(complex(each))
    return len(kept)


def rigid_poses(
    z: ComplexArray, seen: BoolArray | FloatArray, template: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Return the rotation and position (F,) that fit a template to each frame (closed form in the plane).

    The markers z (F, k), m, are 0 where missing, ``seen`` (F, k) is 1 where they are visible, and ``template`` (k,) are
    their coordinates in the body's frame, m.
    """
    counts = np.maximum(seen.sum(axis=1), 1)
    centroid = z.sum(axis=1) / counts
    template_centroid = seen @ template / counts
    moment = z @ np.conj(template) - counts * centroid * np.conj(template_centroid)
    size = np.abs(moment)
    rotation = np.where(size > 0, moment / np.where(size > 0, size, 1), 1)
    return rotation, centroid - rotation * template_centroid


CircleMethod = Literal["kasa", "taubin", "pratt", "geometric"]
CommonMethod = Literal["kasa", "taubin", "geometric"]

_CIRCLE_ITERATIONS = 100
_CIRCLE_TOLERANCE = 1e-10  # relative to the distance of the centre from the track
_HALVINGS = 30
_ROUNDING = 1e-12  # relative increase of the cost due to rounding
_FAR = 1e5  # track lengths; a track with a farther centre is straight
_FLAT = 1e-14  # determinant over squared trace; smaller for a line or a point


@dataclass(frozen=True)
class CircleFit:
    """Circles of M markers about G centres: one centre for each marker (G = M), or one common centre (G = 1).

    The covariance of the centres is first-order, for noise that is independent between frames. The covariance has no
    meaning if the standard error exceeds a quarter of the radius, because the arc is then almost straight. For
    ``kasa``, it does not include the bias.
    """

    method: CircleMethod  # method of the fit
    centre: ComplexArray  # (G,) centres, m; NaN for a still or straight track, or fewer than three frames
    radius: FloatArray  # (M,) mean distances from the centre, m
    residual: FloatArray  # (M,) rms distances of the points from their circles, m; inf without a circle
    covariance: FloatArray  # (G, 2, 2) covariance of the centres, m^2; NaN without degrees of freedom
    settled: BoolArray  # (G,) False without a centre, or if ``geometric`` did not converge

    @property
    def standard_error(self) -> FloatArray:
        """Standard deviations (G,) of the centres in the direction of the radius, in which they are largest, m."""
        xx, xy, yy = self.covariance[:, 0, 0], self.covariance[:, 0, 1], self.covariance[:, 1, 1]
        return np.asarray(np.sqrt((xx + yy + np.hypot(xx - yy, 2 * xy)) / 2))


def fit_circles(points: ComplexArray, method: CircleMethod = "taubin") -> CircleFit:
    """Fit a circle to each marker's track.

    The tracks ``points`` (F, M) are in the frame of the previous segment, m, NaN where missing.
    """
    tracks = _normalise_tracks(points, common=False)
    return _build_fit(tracks, method, *_fit_centre(tracks, method))


def fit_common_centre(points: ComplexArray, method: CommonMethod = "geometric") -> CircleFit:
    """Fit circles with a common centre and one radius for each marker, as the thesis does for a known segment.

    The cost is the sum of the costs of the single fits of all markers. Tracks in different directions from the joint
    determine the centre by the intersection of their normals, and their curvature is hardly needed. ``pratt`` has no
    form with several radii; it raises a ValueError.
    """
    if method not in get_args(CommonMethod):
        raise ValueError(f"method {method!r} has no common centre; use one of {', '.join(get_args(CommonMethod))}")
    tracks = _normalise_tracks(points, common=True)
    return _build_fit(tracks, method, *_fit_centre(tracks, method))


@dataclass(frozen=True)
class _Tracks:
    """Tracks minus their mean, in units of their rms distance from it; both are common for a common centre."""

    z: ComplexArray  # (F, M), zero where missing
    seen: BoolArray  # (F, M)
    frames: FloatArray  # (M,) number of visible frames
    origin: ComplexArray  # (G,)
    scale: FloatArray  # (G,)

    @property
    def common(self) -> bool:
        return bool(len(self.origin) != self.z.shape[1])

    def pool(self, sums: FloatArray) -> FloatArray:
        """Return the sums (G, ...) for each centre from the sums (M, ...) for each marker."""
        return np.asarray(sums.sum(axis=0, keepdims=True)) if self.common else sums

    def mean(self, values: FloatArray) -> FloatArray:
        """Return the means (M,) over the frames in which each marker is visible."""
        return np.asarray((values * self.seen).sum(axis=0) / np.maximum(self.frames, 1))

    def centre(self, values: FloatArray) -> FloatArray:
        """Return values (F, M) minus each marker's mean, zero where missing."""
        return np.asarray((values - self.mean(values)) * self.seen)

    def centre_points(self, z: ComplexArray) -> FloatArray:
        """Return the coordinates (F, M, 2) of points minus their means."""
        return np.stack([self.centre(z.real), self.centre(z.imag)], axis=2)


def _normalise_tracks(points: ComplexArray, *, common: bool) -> _Tracks:
    seen = np.isfinite(points)
    z = np.where(seen, points, 0)
    over = None if common else 0
    count = np.maximum(np.atleast_1d(seen.sum(axis=over)), 1)
    origin = np.atleast_1d(z.sum(axis=over)) / count
    z = (z - origin) * seen
    scale = np.sqrt(np.atleast_1d((np.abs(z) ** 2).sum(axis=over)) / count)
    scale = np.where(scale > 0, scale, 1.0)
    return _Tracks(z / scale, seen, seen.sum(axis=0).astype(np.float64), origin, scale)


def _fit_centre(tracks: _Tracks, method: CircleMethod) -> tuple[ComplexArray, BoolArray]:
    """Return the centres (G,) in the units of the tracks, and whether they have converged."""
    if method == "geometric":
        centre, settled = _fit_geometric(tracks, _fit_taubin(tracks))
    else:
        centre = {"kasa": _fit_kasa, "taubin": _fit_taubin, "pratt": _fit_pratt}[method](tracks)
        settled = np.ones(len(centre), dtype=np.bool_)
    near = np.abs(centre) <= _FAR  # false for NaN
    return np.where(near, centre, np.nan), settled & near


def _fit_kasa(tracks: _Tracks) -> ComplexArray:
    """Return the centres p by Kåsa's method: least squares on |z|^2 = 2 p . z + one constant for each marker (3.8)."""
    design, target = 2 * tracks.centre_points(tracks.z), tracks.centre(np.abs(tracks.z) ** 2)
    pull = tracks.pool(np.einsum("fmi,fm->mi", design, target))
    return _solve(tracks.pool(np.einsum("fmi,fmj->mij", design, design)), pull)


def _fit_taubin(tracks: _Tracks) -> ComplexArray:
    """Return the centres by Taubin's method: eigenvector of the least eigenvalue of moments of (|z|^2 / 2, x, y)."""
    square = tracks.centre(np.abs(tracks.z) ** 2) / 2
    design = np.concatenate([square[..., None], tracks.centre_points(tracks.z)], axis=2)
    moments = tracks.pool(np.einsum("fmi,fmj->mij", design, design))
    smallest = np.linalg.eigh(moments)[1][..., 0]
    return _divide_coefficients(-(smallest[:, 1] + 1j * smallest[:, 2]), smallest[:, 0], moments[:, 1:, 1:])


def _fit_pratt(tracks: _Tracks) -> ComplexArray:
    """Return the centres by Pratt's method: circles A |z|^2 + B . z + D = 0 with the constraint B^2 - 4 A D = 1."""
    z = tracks.z
    design = np.stack([np.abs(z) ** 2, z.real, z.imag, np.ones(z.shape)], axis=2) * tracks.seen[..., None]
    moments = np.einsum("fmi,fmj->mij", design, design)
    inverse = np.diag([0.0, 1.0, 1.0, 0.0])
    inverse[0, 3] = inverse[3, 0] = -0.5
    values, vectors = np.linalg.eig(inverse @ moments)
    # one eigenvalue is negative, as for the discriminant; the fit is the eigenvector of the smallest other one
    second = np.argsort(values.real, axis=1)[:, 1]
    coefficients = np.take_along_axis(vectors.real, second[:, None, None], axis=2)[..., 0]
    return _divide_coefficients(
        -(coefficients[:, 1] + 1j * coefficients[:, 2]), 2 * coefficients[:, 0], moments[:, 1:3, 1:3]
    )


def _fit_geometric(tracks: _Tracks, start: ComplexArray) -> tuple[ComplexArray, BoolArray]:
    """Return the centres p that minimise (|z - p| - r)^2 by Gauss-Newton, where r is the mean distance."""
    centre, settled = start, np.zeros(len(start), dtype=np.bool_)
    direction, off, cost = _measure_distances(tracks, centre)
    for _ in range(_CIRCLE_ITERATIONS):
        normal = tracks.pool(np.einsum("fmi,fmj->mij", direction, direction))
        step = _solve(normal, tracks.pool(np.einsum("fmi,fm->mi", direction, off)))
        moving = np.isfinite(step) & (np.abs(centre) <= _FAR) & ~settled
        settled = settled | (moving & (np.abs(step) <= _CIRCLE_TOLERANCE * (1 + np.abs(centre))))
        step = np.where(moving & ~settled, step, 0)
        if not step.any():
            break
        centre, previous = centre + step, cost
        direction, off, cost = _measure_distances(tracks, centre)
        for _ in range(_HALVINGS):
            climbs = cost > previous * (1 + _ROUNDING)
            if not climbs.any():
                break
            step = np.where(climbs, step / 2, 0)
            centre = centre - step
            direction, off, cost = _measure_distances(tracks, centre)
    return centre, settled


def _measure_distances(tracks: _Tracks, centre: ComplexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return unit vectors (F, M, 2) and distances (F, M) from the centre, minus their means, and the cost (G,)."""
    arm = tracks.z - centre
    distance = np.abs(arm)
    off = tracks.centre(distance)
    unit = tracks.centre_points(arm / np.where(distance > 0, distance, 1))
    return unit, off, tracks.pool((off**2).sum(axis=0))


def _build_fit(tracks: _Tracks, method: CircleMethod, centre: ComplexArray, settled: BoolArray) -> CircleFit:
    direction, off, _ = _measure_distances(tracks, centre)
    covariance = _estimate_covariance(tracks, direction, off)
    if method == "kasa":
        design = 2 * tracks.centre_points(tracks.z)
        fitted = design[..., 0] * centre.real + design[..., 1] * centre.imag
        covariance = _estimate_covariance(tracks, design, tracks.centre(np.abs(tracks.z) ** 2) - fitted)
    known = np.isfinite(centre) & (tracks.frames > 0)
    residual = np.where(known, np.sqrt(tracks.mean(off**2)), np.inf)
    return CircleFit(
        method,
        tracks.origin + tracks.scale * centre,
        np.where(known, tracks.mean(np.abs(tracks.z - centre)), np.nan) * tracks.scale,
        residual * tracks.scale,
        covariance * tracks.scale[:, None, None] ** 2,
        settled,
    )


def _estimate_covariance(tracks: _Tracks, design: FloatArray, off: FloatArray) -> FloatArray:
    """Return the covariance (G, 2, 2) of a least-squares centre; the residuals' variance may differ between frames."""
    normal = tracks.pool(np.einsum("fmi,fmj->mij", design, design))
    scores = design * off[..., None]
    spread = tracks.pool(np.einsum("fmi,fmj->mij", scores, scores))
    rows = tracks.pool(tracks.frames)
    left = rows - 2 - tracks.pool((tracks.frames > 0).astype(np.float64))  # minus centre and radii
    inverse = _invert(normal)
    correction = np.where(left > 0, rows / np.maximum(left, 1), np.nan)
    return np.asarray(correction[:, None, None] * inverse @ spread @ inverse)


def _invert(normal: FloatArray) -> FloatArray:
    """Return inverses (G, 2, 2) of symmetric matrices; NaN if singular."""
    xx, xy, yy = normal[:, 0, 0], normal[:, 0, 1], normal[:, 1, 1]
    determinant = xx * yy - xy**2
    regular = determinant > _FLAT * (xx + yy) ** 2
    adjugate = np.stack([np.stack([yy, -xy], axis=1), np.stack([-xy, xx], axis=1)], axis=1)
    return np.asarray(adjugate / np.where(regular, determinant, np.nan)[:, None, None])


def _solve(normal: FloatArray, pull: FloatArray) -> ComplexArray:
    """Return the solutions (G,) of normal equations as complex numbers."""
    solution = np.einsum("gij,gj->gi", _invert(normal), pull)
    return np.asarray(solution[:, 0] + 1j * solution[:, 1])


def _divide_coefficients(above: ComplexArray, below: FloatArray, moments: FloatArray) -> ComplexArray:
    """Return the centres (G,) from circle coefficients; NaN if the moments (G, 2, 2) belong to a line or a point."""
    known = np.isfinite(_invert(moments)[:, 0, 0]) & (below != 0)
    return np.where(known, above / np.where(known, below, 1), np.nan + 0j)


_RIDGE = 1e-13  # larger than rounding errors; without rotation, the smallest solution is returned
_NORMAL_MEDIAN = 0.6745  # median modulus of a standard normal variable
_ASIDE = 0.03  # m; markers closer to the mid-plane are on neither side
_THIRD_DIFFERENCE = 20.0  # variance of a third difference of white noise of variance 1


@dataclass(frozen=True)
class PairJoint:
    """Hinge between a parent and a child body."""

    in_parent: complex  # centre of the joint in the parent's frame, m
    in_child: complex  # centre of the joint in the child's frame, m
    residual: float  # rms distance between the two points over the frames, m
    arc: float  # 2.5 to 97.5 % range of the relative angle, rad


def fit_joint(parent: RigidBody, child: RigidBody) -> PairJoint:
    """Fit the centre of rotation of two bodies by linear least squares, corrected for the bias from angle noise.

    With the bodies' rotations r and s (unit complex numbers) and the vector g between their origins, the coincident
    points p of the parent and q of the child satisfy r p - s q = g (the two-sided form of 3.13). Least squares over the
    frames gives

        [ 1    -C ] [p]   [ f]        C = mean(r* s),
        [-C*    1 ] [q] = [-h],       f = mean(r* g),  h = mean(s* g).

    Angle noise of variance v multiplies the mean of a rotation by 1 - v/2. C, f and h then belong to the points (1 -
    v_r/2) p and (1 - v_s/2) q, but r* r on the diagonal stays 1 instead of (1 - v_r/2)^2. This error moves the centre
    towards the markers. Therefore v_r and v_s are subtracted from the diagonal (:func:`_angle_noise`). The noise of a
    body's origin, its centroid, is independent of the noise of its angle.

    At most half of the variance of the relative angle is subtracted, and nothing if noise could explain all of it. The
    centre is then poorly determined and stays near the noisier body's centroid; ``arc`` is then small.
    """
    both = np.isfinite(parent.rotation) & np.isfinite(child.rotation)
    frames = int(both.sum())
    if frames < 3:
        return PairJoint(0j, 0j, np.inf, 0.0)
    r, s = parent.rotation[both], child.rotation[both]
    gap = child.position[both] - parent.position[both]
    relative = np.conj(r) * s
    angle = np.unwrap(np.angle(relative))
    c, f, h = complex(relative.mean()), complex(np.vdot(r, gap)) / frames, complex(np.vdot(s, gap)) / frames
    noise = _angle_noise(angle, 1 - abs(c) ** 2, (parent, r), (child, s))
    first, second = 1 - noise + _RIDGE
    determinant = first * second - abs(c) ** 2
    p, q = (second * f - c * h) / determinant, (np.conj(c) * f - first * h) / determinant
    off = r * p - s * q - gap
    return PairJoint(complex(p), complex(q), float(np.sqrt(np.vdot(off, off).real / frames)), _measure_range(angle))


def _angle_noise(angle: FloatArray, variance: float, *bodies: tuple[RigidBody, ComplexArray]) -> FloatArray:
    """Return the variances (2,) to subtract for the two bodies' rotations, rad^2.

    The residual of a body and the variance of its rotation are both upper limits of its angle noise (the base has
    none). Skin that slides with the angle also leaves a residual, but no angle noise. The sum of the two variances is
    therefore limited to the white part of the relative ``angle`` (F,): the variance of its third differences, to which
    the movement contributes little, divided by 20. The median of the differences ignores frames with fast movement.
    """
    stated = np.array([min(body.angle_noise**2, max(1 - abs(u.mean()) ** 2, 0)) for body, u in bodies])
    total = float(stated.sum())
    if total == 0 or variance <= 0 or len(angle) < 4:
        return np.zeros(2)
    third = np.sort(np.abs(angle[3:] - angle[:-3] + 3 * (angle[1:-2] - angle[2:-1])))
    white = min(total, (third[len(third) // 2] / _NORMAL_MEDIAN) ** 2 / _THIRD_DIFFERENCE)
    believed = np.clip(variance / white - 1, 0, 1) if white > 0 else 0.0
    return np.asarray(stated * (believed * white / total))


def arc(rotation: ComplexArray) -> float:
    """Return the 2.5 to 97.5 % range of an unwrapped rotation (F,), rad."""
    angle = unwrap_rotation(rotation)
    return _measure_range(angle[np.isfinite(angle)])


def _measure_range(angle: FloatArray) -> float:
    """Return the 2.5 to 97.5 % range of angles (F,), rad; ``np.quantile`` takes twenty times as long."""
    last = len(angle) - 1
    low, high = np.interp([0.025 * last, 0.975 * last], np.arange(len(angle)), np.sort(angle))
    return float(high - low)


def unwrap_rotation(rotation: ComplexArray) -> FloatArray:
    """Return the unwrapped angle (F,) of a rotation, rad; NaN where it is unknown."""
    angle = np.full(len(rotation), np.nan)
    known = np.isfinite(rotation)
    angle[known] = np.unwrap(np.angle(rotation[known]))
    return angle


def measure_asymmetry(points: ComplexArray, lateral: FloatArray, segment: IntArray) -> FloatArray:
    """Return the standard deviation (n,) of the angle between left and right side of segments 1 … n, rad.

    A sagittal segment represents both sides, which assumes that this angle is nearly constant. The result is NaN with
    fewer than two markers on a side. ``points`` (F, M) are trajectories in the plane, m, ``lateral`` (M,) mean
    out-of-plane coordinates, m, and ``segment`` (M,) is 0 on the base and -1 on no segment.
    """
    middle = np.nanmean(lateral[segment > 0])
    return np.array(
        [_compare_sides(points, lateral - middle, np.flatnonzero(segment == k)) for k in range(1, segment.max() + 1)]
    )


def _compare_sides(points: ComplexArray, lateral: FloatArray, members: IntArray) -> float:
    """Return the standard deviation of the angle between the left and the right markers of a segment, rad."""
    sides = members[lateral[members] < -_ASIDE], members[lateral[members] > _ASIDE]
    if min(len(side) for side in sides) < 2:
        return np.nan
    left, right = (fit_body(points, side) for side in sides)
    difference = unwrap_rotation(left.rotation * np.conj(right.rotation))
    known = difference[np.isfinite(difference)]
    return float(np.std(known)) if len(known) else np.nan
