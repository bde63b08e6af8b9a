"""Rigid bodies in the plane, circles of markers, and the joint between two bodies."""

from __future__ import annotations

from dataclasses import dataclass

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
        """Return trajectories (F, M) in the body's frame."""
        return np.asarray(np.conj(self.rotation)[:, None] * (points - self.position[:, None]))


def fit_body(points: ComplexArray, markers: IntArray) -> RigidBody:
    """Fit a rigid body to markers by least squares (generalised Procrustes analysis over the frames, ignoring gaps).

    ``markers`` are at least two columns of the trajectories (F, M), m, NaN where missing.
    """
    seen = np.isfinite(points[:, markers])
    z = np.where(seen, points[:, markers], 0)
    weight = seen.astype(np.float64)
    template = z[int(np.argmax(seen.sum(axis=1)))]
    for _ in range(_ITERATIONS):
        rotation, position = planar_poses(z, weight, template)
        back = np.conj(rotation)
        updated = (back @ z - (back * position) @ weight) / np.maximum(weight.sum(axis=0), 1)
        updated -= updated.mean()
        moved = float(np.max(np.abs(updated - template)))
        template = updated
        if moved < _TOLERANCE:
            break
    rotation, position = planar_poses(z, weight, template)
    enough = seen.sum(axis=1) >= 2
    off = np.abs(z - position[:, None] - rotation[:, None] * template)[seen & enough[:, None]]
    residual = float(np.sqrt(np.mean(off**2))) if off.size else np.inf
    unknown = np.where(enough, 1.0, np.nan)
    return RigidBody(markers, template, rotation * unknown, position * unknown, residual)


def still_body(points: ComplexArray, markers: IntArray) -> RigidBody:
    """Return the fixed base as a rigid body whose frame is the plane frame."""
    template = np.nanmean(points[:, markers], axis=0)
    residual = float(np.sqrt(np.nanmean(np.abs(points[:, markers] - template) ** 2)))
    fixed = np.ones(len(points), dtype=np.complex128)
    return RigidBody(markers, template, fixed, 0 * fixed, residual)


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


def unit_directions(moment: ComplexArray) -> ComplexArray:
    """Return complex numbers scaled to length 1; zeros become 1."""
    size = np.abs(moment)
    return np.where(size > 0, moment / np.where(size > 0, size, 1), 1)


def planar_poses(
    z: ComplexArray, seen: BoolArray | FloatArray, template: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Return the rotation and position (F,) that fit a template to each frame (closed form in the plane).

    The markers z (F, k), m, are 0 where missing, ``seen`` (F, k) is 1 where they are visible, and ``template`` (k,) are
    their coordinates in the body's frame, m.
    """
    counts = np.maximum(seen.sum(axis=1), 1)
    centroid = z.sum(axis=1) / counts
    template_centroid = seen @ template / counts
    rotation = unit_directions(z @ np.conj(template) - counts * centroid * np.conj(template_centroid))
    return rotation, centroid - rotation * template_centroid


_FAR = 1e5  # track lengths; a track with a farther centre is straight
_FLAT = 1e-14  # determinant over squared trace; smaller for a line or a point


def fit_circles(points: ComplexArray) -> ComplexArray:
    """Return the centre of the circle through each marker's track (M,), m, by Taubin's method.

    The centre is an eigenvector of the least eigenvalue of the moments of (|z|^2 / 2, x, y). It is NaN for a still or
    straight track, or fewer than three frames. The tracks ``points`` (F, M) are in the frame of the previous segment,
    m, NaN where missing.
    """
    z, seen, origin, scale = _normalise_tracks(points, over=0)
    square = _subtract_means(np.abs(z) ** 2, seen) / 2
    design = np.stack([square, _subtract_means(z.real, seen), _subtract_means(z.imag, seen)], axis=2)
    moments = np.einsum("fmi,fmj->mij", design, design)
    smallest = np.linalg.eigh(moments)[1][..., 0]
    known = np.isfinite(invert_symmetric(moments[:, 1:, 1:])[:, 0, 0]) & (smallest[:, 0] != 0)
    above, below = -(smallest[:, 1] + 1j * smallest[:, 2]), smallest[:, 0]
    centre = np.where(known, above / np.where(known, below, 1), np.nan + 0j)
    return np.asarray(origin + scale * np.where(np.abs(centre) <= _FAR, centre, np.nan))  # false for NaN


def fit_common_centre(points: ComplexArray) -> complex:
    """Return the common centre, m, of the circles through the tracks of a segment, by Kåsa's method, as in the thesis.

    The centre p is the solution of least squares on |z|^2 = 2 p . z + one constant for each marker (3.8). Tracks in
    different directions from the joint determine it by the intersection of their normals. Points and missing centres
    are as for :func:`fit_circles`.
    """
    z, seen, origin, scale = _normalise_tracks(points, over=None)
    design = 2 * np.stack([_subtract_means(z.real, seen), _subtract_means(z.imag, seen)], axis=2)
    target = _subtract_means(np.abs(z) ** 2, seen)
    pull = np.einsum("fmi,fm->mi", design, target).sum(axis=0, keepdims=True)
    normal = np.einsum("fmi,fmj->mij", design, design).sum(axis=0, keepdims=True)
    solution = np.einsum("gij,gj->gi", invert_symmetric(normal), pull)
    centre = solution[:, 0] + 1j * solution[:, 1]
    return complex((origin + scale * np.where(np.abs(centre) <= _FAR, centre, np.nan))[0])


def _normalise_tracks(
    points: ComplexArray, over: int | None
) -> tuple[ComplexArray, BoolArray, ComplexArray, FloatArray]:
    """Return tracks (F, M) minus their mean, in units of their rms distance from it, 0 where missing.

    The other results are the visible samples (F, M), the means and the units; both are common if ``over`` is None.
    """
    seen = np.isfinite(points)
    z = np.where(seen, points, 0)
    count = np.maximum(np.atleast_1d(seen.sum(axis=over)), 1)
    origin = np.atleast_1d(z.sum(axis=over)) / count
    z = (z - origin) * seen
    scale = np.sqrt(np.atleast_1d((np.abs(z) ** 2).sum(axis=over)) / count)
    scale = np.where(scale > 0, scale, 1.0)
    return z / scale, seen, origin, scale


def _subtract_means(values: FloatArray, seen: BoolArray) -> FloatArray:
    """Return values (F, M) minus each marker's mean, 0 where missing."""
    mean = (values * seen).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    return np.asarray((values - mean) * seen)


def invert_symmetric(normal: FloatArray) -> FloatArray:
    """Return inverses (G, 2, 2) of symmetric matrices; NaN if singular."""
    xx, xy, yy = normal[:, 0, 0], normal[:, 0, 1], normal[:, 1, 1]
    determinant = xx * yy - xy**2
    regular = determinant > _FLAT * (xx + yy) ** 2
    adjugate = np.stack([np.stack([yy, -xy], axis=1), np.stack([-xy, xx], axis=1)], axis=1)
    return np.asarray(adjugate / np.where(regular, determinant, np.nan)[:, None, None])


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
    towards the markers. Therefore v_r and v_s are subtracted from the diagonal. The noise of a
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

    # The residual of a body and the variance of its rotation are both upper limits of its angle noise (the base has
    # none). Skin that slides with the angle also leaves a residual, but no angle noise. The sum of the two variances is
    # therefore limited to the white part of the relative angle: the variance of its third differences, to which the
    # movement contributes little, divided by 20. The median of the differences ignores frames with fast movement.
    stated = np.array(
        [min(body.angle_noise**2, max(1 - abs(u.mean()) ** 2, 0)) for body, u in ((parent, r), (child, s))]
    )
    total, variance, noise = float(stated.sum()), 1 - abs(c) ** 2, np.zeros(2)
    if total > 0 and variance > 0 and frames >= 4:
        third = np.sort(np.abs(angle[3:] - angle[:-3] + 3 * (angle[1:-2] - angle[2:-1])))
        white = min(total, (third[len(third) // 2] / _NORMAL_MEDIAN) ** 2 / _THIRD_DIFFERENCE)
        believed = np.clip(variance / white - 1, 0, 1) if white > 0 else 0.0
        noise = stated * (believed * white / total)
    first, second = 1 - noise + _RIDGE
    determinant = first * second - abs(c) ** 2
    p, q = (second * f - c * h) / determinant, (np.conj(c) * f - first * h) / determinant
    off = r * p - s * q - gap
    return PairJoint(complex(p), complex(q), float(np.sqrt(np.vdot(off, off).real / frames)), measure_range(angle))


def arc(rotation: ComplexArray) -> float:
    """Return the 2.5 to 97.5 % range of an unwrapped rotation (F,), rad."""
    angle = unwrap_rotation(rotation)
    return measure_range(angle[np.isfinite(angle)])


def measure_range(angle: FloatArray) -> float:
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
    aside = lateral - np.nanmean(lateral[segment > 0])
    asymmetry = np.full(segment.max(), np.nan)
    for k in range(1, segment.max() + 1):
        sides = np.flatnonzero((segment == k) & (aside < -_ASIDE)), np.flatnonzero((segment == k) & (aside > _ASIDE))
        if min(len(side) for side in sides) < 2:
            continue
        left, right = (fit_body(points, side) for side in sides)
        difference = unwrap_rotation(left.rotation * np.conj(right.rotation))
        known = difference[np.isfinite(difference)]
        if len(known):
            asymmetry[k - 1] = float(np.std(known))
    return asymmetry
