"""Circles through the tracks of single markers, and a common centre of several tracks (3.8).

The thesis locates joints with these methods; they are kept for comparison. A single marker determines its joint only by
the curvature of its track. The sagitta of the track is r arc^2 / 8, which is one or two millimetres at 10 degrees. A
body of several markers also provides its rotation (:func:`mocap_id.kinematics.joint.fit_joint`). The four methods
define the distance of a point from a circle differently, so noise has different effects on a short arc:

``kasa``
    The method of 3.8 (where r stands for r^2): squared distance minus squared radius, linear. Noise shifts the centre
    towards the track, by half the radius if r arc^2 is 27 standard deviations of the noise.
``taubin``, ``pratt``
    The same algebraic distance, divided by its mean gradient (Taubin) or by the discriminant of the circle's equation
    (Pratt). Practically no bias, one small eigenvalue problem for each marker, no iteration.
``geometric``
    True distances, by Gauss-Newton with the radii eliminated, starting from Taubin's circle.

Points of the plane are complex numbers, as in :mod:`mocap_id.kinematics.rigid_body`. All markers are fitted at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray

CircleMethod = Literal["kasa", "taubin", "pratt", "geometric"]
CommonMethod = Literal["kasa", "taubin", "geometric"]

_ITERATIONS = 100
_TOLERANCE = 1e-10  # relative to the distance of the centre from the track
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
    for _ in range(_ITERATIONS):
        normal = tracks.pool(np.einsum("fmi,fmj->mij", direction, direction))
        step = _solve(normal, tracks.pool(np.einsum("fmi,fm->mi", direction, off)))
        moving = np.isfinite(step) & (np.abs(centre) <= _FAR) & ~settled
        settled = settled | (moving & (np.abs(step) <= _TOLERANCE * (1 + np.abs(centre))))
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
