"""Four circle fits: Kåsa's and Taubin's, as in the pipeline, and Pratt's and the geometric one for comparison."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray
from mocap_id.kinematics.joint import invert_symmetric

CircleMethod = Literal["kasa", "taubin", "pratt", "geometric"]
CommonMethod = Literal["kasa", "taubin", "geometric"]

_CIRCLE_ITERATIONS = 100
_CIRCLE_TOLERANCE = 1e-10  # relative to the distance of the centre from the track
_HALVINGS = 30
_ROUNDING = 1e-12  # relative increase of the cost due to rounding
_FAR = 1e5  # track lengths; a track with a farther centre is straight


@dataclass(frozen=True)
class CircleFit:
    """Circles of M markers about G centres: one centre for each marker (G = M), or one common centre (G = 1)."""

    centre: ComplexArray  # (G,) centres, m; NaN for a still or straight track, or fewer than three frames
    radius: FloatArray  # (M,) mean distances from the centre, m
    residual: FloatArray  # (M,) rms distances of the points from their circles, m; inf without a circle


def fit_circles(points: ComplexArray, method: CircleMethod = "taubin") -> CircleFit:
    """Fit a circle to each marker's track.

    The tracks ``points`` (F, M) are in the frame of the previous segment, m, NaN where missing.
    """
    return _fit_tracks(points, method, common=False)


def fit_common_centre(points: ComplexArray, method: CommonMethod = "geometric") -> CircleFit:
    """Fit circles with a common centre and one radius for each marker, as the thesis does for a known segment.

    The cost is the sum of the costs of the single fits of all markers. Tracks in different directions from the joint
    determine the centre by the intersection of their normals, and their curvature is hardly needed. ``pratt`` has no
    form with several radii; it raises a ValueError.
    """
    if method not in get_args(CommonMethod):
        raise ValueError(f"method {method!r} has no common centre; use one of {', '.join(get_args(CommonMethod))}")
    return _fit_tracks(points, method, common=True)


@dataclass(frozen=True)
class _Tracks:
    """Tracks minus their mean, in units of their rms distance from it; both are common for a common centre."""

    z: ComplexArray  # (F, M), zero where missing
    seen: BoolArray  # (F, M)
    common: bool

    def pool(self, sums: FloatArray) -> FloatArray:
        """Return the sums (G, ...) for each centre from the sums (M, ...) for each marker."""
        return np.asarray(sums.sum(axis=0, keepdims=True)) if self.common else sums

    def moments(self, design: FloatArray) -> FloatArray:
        """Return the second moments (G, k, k) of the rows (F, M, k)."""
        return self.pool(np.einsum("fmi,fmj->mij", design, design))

    def mean(self, values: FloatArray) -> FloatArray:
        """Return the means (M,) over the frames in which each marker is visible."""
        return np.asarray((values * self.seen).sum(axis=0) / np.maximum(self.seen.sum(axis=0).astype(np.float64), 1))

    def centre(self, values: FloatArray) -> FloatArray:
        """Return values (F, M) minus each marker's mean, zero where missing."""
        return np.asarray((values - self.mean(values)) * self.seen)

    def centre_points(self, z: ComplexArray) -> FloatArray:
        """Return the coordinates (F, M, 2) of points minus their means."""
        return np.stack([self.centre(z.real), self.centre(z.imag)], axis=2)


def _fit_tracks(points: ComplexArray, method: CircleMethod, *, common: bool) -> CircleFit:
    seen = np.isfinite(points)
    z = np.where(seen, points, 0)
    over = None if common else 0
    count = np.maximum(np.atleast_1d(seen.sum(axis=over)), 1)
    origin = np.atleast_1d(z.sum(axis=over)) / count
    z = (z - origin) * seen
    scale = np.sqrt(np.atleast_1d((np.abs(z) ** 2).sum(axis=over)) / count)
    scale = np.where(scale > 0, scale, 1.0)
    tracks = _Tracks(z / scale, seen, common)
    centre = {"kasa": _fit_kasa, "taubin": _fit_taubin, "pratt": _fit_pratt, "geometric": _fit_geometric}[method](
        tracks
    )
    centre = np.where(np.abs(centre) <= _FAR, centre, np.nan)  # false for NaN
    distance = np.abs(tracks.z - centre)
    known = np.isfinite(centre) & seen.any(axis=0)
    return CircleFit(
        origin + scale * centre,
        np.where(known, tracks.mean(distance), np.nan) * scale,
        np.where(known, np.sqrt(tracks.mean(tracks.centre(distance) ** 2)), np.inf) * scale,
    )


def _fit_kasa(tracks: _Tracks) -> ComplexArray:
    """Return the centres p by Kåsa's method: least squares on |z|^2 = 2 p . z + one constant for each marker (3.8)."""
    design, target = 2 * tracks.centre_points(tracks.z), tracks.centre(np.abs(tracks.z) ** 2)
    pull = tracks.pool(np.einsum("fmi,fm->mi", design, target))
    return _solve(tracks.moments(design), pull)


def _fit_taubin(tracks: _Tracks) -> ComplexArray:
    """Return the centres by Taubin's method: eigenvector of the least eigenvalue of moments of (|z|^2 / 2, x, y)."""
    square = tracks.centre(np.abs(tracks.z) ** 2) / 2
    moments = tracks.moments(np.concatenate([square[..., None], tracks.centre_points(tracks.z)], axis=2))
    smallest = np.linalg.eigh(moments)[1][..., 0]
    return _divide_coefficients(-(smallest[:, 1] + 1j * smallest[:, 2]), smallest[:, 0], moments[:, 1:, 1:])


def _fit_pratt(tracks: _Tracks) -> ComplexArray:
    """Return the centres by Pratt's method: circles A |z|^2 + B . z + D = 0 with the constraint B^2 - 4 A D = 1."""
    z = tracks.z
    moments = tracks.moments(
        np.stack([np.abs(z) ** 2, z.real, z.imag, np.ones(z.shape)], axis=2) * tracks.seen[..., None]
    )
    inverse = np.diag([0.0, 1.0, 1.0, 0.0])
    inverse[0, 3] = inverse[3, 0] = -0.5
    values, vectors = np.linalg.eig(inverse @ moments)
    # one eigenvalue is negative, as for the discriminant; the fit is the eigenvector of the smallest other one
    second = np.argsort(values.real, axis=1)[:, 1]
    coefficients = np.take_along_axis(vectors.real, second[:, None, None], axis=2)[..., 0]
    return _divide_coefficients(
        -(coefficients[:, 1] + 1j * coefficients[:, 2]), 2 * coefficients[:, 0], moments[:, 1:3, 1:3]
    )


def _fit_geometric(tracks: _Tracks) -> ComplexArray:
    """Return the centres p that minimise (|z - p| - r)^2 by Gauss-Newton, where r is the mean distance."""

    def measure(centre: ComplexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return unit vectors (F, M, 2) and distances (F, M) from the centre, minus their means, and the cost (G,)."""
        arm = tracks.z - centre
        distance = np.abs(arm)
        off = tracks.centre(distance)
        return tracks.centre_points(arm / np.where(distance > 0, distance, 1)), off, tracks.pool((off**2).sum(axis=0))

    centre = _fit_taubin(tracks)
    settled = np.zeros(len(centre), dtype=np.bool_)
    direction, off, cost = measure(centre)
    for _ in range(_CIRCLE_ITERATIONS):
        step = _solve(tracks.moments(direction), tracks.pool(np.einsum("fmi,fm->mi", direction, off)))
        moving = np.isfinite(step) & (np.abs(centre) <= _FAR) & ~settled
        settled = settled | (moving & (np.abs(step) <= _CIRCLE_TOLERANCE * (1 + np.abs(centre))))
        step = np.where(moving & ~settled, step, 0)
        if not step.any():
            break
        centre, previous = centre + step, cost
        direction, off, cost = measure(centre)
        for _ in range(_HALVINGS):
            climbs = cost > previous * (1 + _ROUNDING)
            if not climbs.any():
                break
            step = np.where(climbs, step / 2, 0)
            centre = centre - step
            direction, off, cost = measure(centre)
    return centre


def _solve(normal: FloatArray, pull: FloatArray) -> ComplexArray:
    """Return the solutions (G,) of normal equations as complex numbers."""
    solution = np.einsum("gij,gj->gi", invert_symmetric(normal), pull)
    return np.asarray(solution[:, 0] + 1j * solution[:, 1])


def _divide_coefficients(above: ComplexArray, below: FloatArray, moments: FloatArray) -> ComplexArray:
    """Return the centres (G,) from circle coefficients; NaN if the moments (G, 2, 2) belong to a line or a point."""
    known = np.isfinite(invert_symmetric(moments)[:, 0, 0]) & (below != 0)
    return np.where(known, above / np.where(known, below, 1), np.nan + 0j)
