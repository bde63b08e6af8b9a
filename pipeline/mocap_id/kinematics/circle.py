"""Circles through the tracks of single markers, and the centre that several tracks share (3.8).

This is how the thesis places a joint, kept to be compared with. One marker sees its joint only by the curvature of its
track, whose sagitta is r arc^2 / 8, a millimetre or two at 10 degrees; a body of several markers also shows by how much
it turned (:func:`mocap_id.kinematics.joint.fit_joint`). Four fits differ in what they call the distance of a point from
a circle, and so in what noise does to a short arc:

``kasa``
    The one of 3.8 (r there stands for r^2): squared distance against squared radius, linear. Noise draws the centre
    towards the track: on an arc of r arc^2 = 27 noise standard deviations by half the radius.
``taubin``, ``pratt``
    The same algebraic distance over its mean gradient (Taubin) or over the discriminant of the circle's equation
    (Pratt). No bias to speak of, one small eigenproblem a marker, no iteration.
``geometric``
    True distances, by Gauss-Newton with the radii eliminated, from Taubin's circle.

Points of the plane are complex numbers, as in :mod:`mocap_id.kinematics.rigid`. All markers are fitted at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray

CircleMethod = Literal["kasa", "taubin", "pratt", "geometric"]
CommonMethod = Literal["kasa", "taubin", "geometric"]

_ITERATIONS = 100
_TOLERANCE = 1e-10  # of the centre's distance from the track
_HALVINGS = 30
_ROUNDING = 1e-12  # relative rise of a cost that is none
_FAR = 1e5  # track lengths beyond which a centre is at infinity and the track straight
_FLAT = 1e-14  # determinant over squared trace below which a track is straight or a point


@dataclass(frozen=True)
class CircleFit:
    """Circles of M markers about G centres: one each (G = M) or one for all (G = 1).

    Parameters
    ----------
    method : str
        How the circles were fitted.
    centre : (G,) complex array
        In the plane of the points, m; NaN where there is none: a still or straight track, fewer than three frames.
    radius : (M,) array
        Mean distance from the centre, m.
    residual : (M,) array
        rms distance of the points from their circle, m; inf where there is none.
    covariance : (G, 2, 2) array
        Of the centre, to first order, for noise that is independent from frame to frame, m^2; NaN where no frame is
        left over to tell the noise. ``kasa``: its spread alone, not its bias, and too wide where there is a bias. It
        means little where the standard error exceeds a quarter of the radius: such an arc can hardly be told from a
        straight line.
    settled : (G,) bool array
        False where there is no centre, or ``geometric`` did not reach its minimum.
    """

    method: CircleMethod
    centre: ComplexArray
    radius: FloatArray
    residual: FloatArray
    covariance: FloatArray
    settled: BoolArray

    @property
    def standard_error(self) -> FloatArray:
        """(G,) standard deviation of the centre along its worst direction, which is that of the radius, m."""
        xx, xy, yy = self.covariance[:, 0, 0], self.covariance[:, 0, 1], self.covariance[:, 1, 1]
        return np.asarray(np.sqrt((xx + yy + np.hypot(xx - yy, 2 * xy)) / 2))


def fit_circles(points: ComplexArray, method: CircleMethod = "taubin") -> CircleFit:
    """A circle through every marker's track by itself.

    Parameters
    ----------
    points : (F, M) complex array
        Tracks in the frame of the segment before, m; NaN where unseen.
    method : str
        See the module.
    """
    tracks = _tracks(points, common=False)
    return _finish(tracks, method, *_centre(tracks, method))


def fit_common_centre(points: ComplexArray, method: CommonMethod = "geometric") -> CircleFit:
    """Circles about one centre, a radius for each marker: what the thesis looks for once it has its circles.

    The squared residuals are those of the single fits, summed over the markers. Tracks that lie in different
    directions from the joint fix it where their normals meet, and then hardly need their curvature.

    Parameters
    ----------
    points : (F, M) complex array
        Tracks of the markers of one segment in the frame of the one before, m; NaN where unseen.
    method : str
        See the module; Pratt's normalisation has no form for several radii.

    Raises
    ------
    ValueError
        Another method.
    """
    if method not in get_args(CommonMethod):
        raise ValueError(f"no common centre by {method!r}; there are {', '.join(get_args(CommonMethod))}")
    tracks = _tracks(points, common=True)
    return _finish(tracks, method, *_centre(tracks, method))


@dataclass(frozen=True)
class _Tracks:
    """Tracks about their mean, in units of their rms distance from it; what shares a centre shares mean and unit."""

    z: ComplexArray  # (F, M), zero where unseen
    seen: BoolArray  # (F, M)
    frames: FloatArray  # (M,) how many are seen
    origin: ComplexArray  # (G,)
    scale: FloatArray  # (G,)

    @property
    def common(self) -> bool:
        return bool(len(self.origin) != self.z.shape[1])

    def pooled(self, sums: FloatArray) -> FloatArray:
        """(G, ...) sums over all that shares a centre from those of the markers (M, ...)."""
        return np.asarray(sums.sum(axis=0, keepdims=True)) if self.common else sums

    def mean(self, values: FloatArray) -> FloatArray:
        """(M,) mean over the frames in which each marker is seen."""
        return np.asarray((values * self.seen).sum(axis=0) / np.maximum(self.frames, 1))

    def centred(self, values: FloatArray) -> FloatArray:
        """(F, M) deviations from each marker's mean, zero where unseen: a constant of its own is eliminated."""
        return np.asarray((values - self.mean(values)) * self.seen)

    def centred_points(self, z: ComplexArray) -> FloatArray:
        """(F, M, 2) the same for points, in coordinates."""
        return np.stack([self.centred(z.real), self.centred(z.imag)], axis=2)


def _tracks(points: ComplexArray, *, common: bool) -> _Tracks:
    seen = np.isfinite(points)
    z = np.where(seen, points, 0)
    over = None if common else 0
    count = np.maximum(np.atleast_1d(seen.sum(axis=over)), 1)
    origin = np.atleast_1d(z.sum(axis=over)) / count
    z = (z - origin) * seen
    scale = np.sqrt(np.atleast_1d((np.abs(z) ** 2).sum(axis=over)) / count)
    scale = np.where(scale > 0, scale, 1.0)
    return _Tracks(z / scale, seen, seen.sum(axis=0).astype(np.float64), origin, scale)


def _centre(tracks: _Tracks, method: CircleMethod) -> tuple[ComplexArray, BoolArray]:
    """(G,) centres in the units of the tracks, and whether they are final."""
    if method == "geometric":
        centre, settled = _geometric(tracks, _taubin(tracks))
    else:
        centre = {"kasa": _kasa, "taubin": _taubin, "pratt": _pratt}[method](tracks)
        settled = np.ones(len(centre), dtype=np.bool_)
    near = np.abs(centre) <= _FAR  # NaN is not
    return np.where(near, centre, np.nan), settled & near


def _kasa(tracks: _Tracks) -> ComplexArray:
    """|z|^2 = 2 p . z + constant of the marker, by linear least squares (3.8)."""
    design, target = 2 * tracks.centred_points(tracks.z), tracks.centred(np.abs(tracks.z) ** 2)
    pull = tracks.pooled(np.einsum("fmi,fm->mi", design, target))
    return _solved(tracks.pooled(np.einsum("fmi,fmj->mij", design, design)), pull)


def _taubin(tracks: _Tracks) -> ComplexArray:
    """Smallest eigenvector of the moments of (|z|^2 / 2, x, y): in these units the mean squared gradient is 1."""
    square = tracks.centred(np.abs(tracks.z) ** 2) / 2
    design = np.concatenate([square[..., None], tracks.centred_points(tracks.z)], axis=2)
    moments = tracks.pooled(np.einsum("fmi,fmj->mij", design, design))
    smallest = np.linalg.eigh(moments)[1][..., 0]
    return _quotient(-(smallest[:, 1] + 1j * smallest[:, 2]), smallest[:, 0], moments[:, 1:, 1:])


def _pratt(tracks: _Tracks) -> ComplexArray:
    """Eigenvector of the moments of (|z|^2, x, y, 1) against the discriminant B^2 - 4 A D."""
    z = tracks.z
    design = np.stack([np.abs(z) ** 2, z.real, z.imag, np.ones(z.shape)], axis=2) * tracks.seen[..., None]
    moments = np.einsum("fmi,fmj->mij", design, design)
    inverse = np.diag([0.0, 1.0, 1.0, 0.0])
    inverse[0, 3] = inverse[3, 0] = -0.5
    values, vectors = np.linalg.eig(inverse @ moments)
    # one value is negative, as one of the discriminant's is; the fit belongs to the least of the others
    second = np.argsort(values.real, axis=1)[:, 1]
    found = np.take_along_axis(vectors.real, second[:, None, None], axis=2)[..., 0]
    return _quotient(-(found[:, 1] + 1j * found[:, 2]), 2 * found[:, 0], moments[:, 1:3, 1:3])


def _geometric(tracks: _Tracks, start: ComplexArray) -> tuple[ComplexArray, BoolArray]:
    """Least squares of |z - p| - r by Gauss-Newton on p, r being the mean distance; steps that climb are halved."""
    centre, settled = start, np.zeros(len(start), dtype=np.bool_)
    direction, off, cost = _distances(tracks, centre)
    for _ in range(_ITERATIONS):
        normal = tracks.pooled(np.einsum("fmi,fmj->mij", direction, direction))
        step = _solved(normal, tracks.pooled(np.einsum("fmi,fm->mi", direction, off)))
        moving = np.isfinite(step) & (np.abs(centre) <= _FAR) & ~settled
        settled = settled | (moving & (np.abs(step) <= _TOLERANCE * (1 + np.abs(centre))))
        step = np.where(moving & ~settled, step, 0)
        if not step.any():
            break
        centre, previous = centre + step, cost
        direction, off, cost = _distances(tracks, centre)
        for _ in range(_HALVINGS):
            climbs = cost > previous * (1 + _ROUNDING)
            if not climbs.any():
                break
            step = np.where(climbs, step / 2, 0)
            centre = centre - step
            direction, off, cost = _distances(tracks, centre)
    return centre, settled


def _distances(tracks: _Tracks, centre: ComplexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(F, M, 2) unit vectors from the centre and (F, M) distances from it, less their means, and (G,) the cost."""
    arm = tracks.z - centre
    distance = np.abs(arm)
    off = tracks.centred(distance)
    unit = tracks.centred_points(arm / np.where(distance > 0, distance, 1))
    return unit, off, tracks.pooled((off**2).sum(axis=0))


def _finish(tracks: _Tracks, method: CircleMethod, centre: ComplexArray, settled: BoolArray) -> CircleFit:
    """Radii, residuals and covariance about the centres, in the units of the points."""
    direction, off, _ = _distances(tracks, centre)
    covariance = _sandwich(tracks, direction, off)
    if method == "kasa":
        design = 2 * tracks.centred_points(tracks.z)
        fitted = design[..., 0] * centre.real + design[..., 1] * centre.imag
        covariance = _sandwich(tracks, design, tracks.centred(np.abs(tracks.z) ** 2) - fitted)
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


def _sandwich(tracks: _Tracks, design: FloatArray, off: FloatArray) -> FloatArray:
    """(G, 2, 2) covariance of a least-squares centre whose residuals may differ in size from frame to frame."""
    normal = tracks.pooled(np.einsum("fmi,fmj->mij", design, design))
    scores = design * off[..., None]
    spread = tracks.pooled(np.einsum("fmi,fmj->mij", scores, scores))
    rows = tracks.pooled(tracks.frames)
    left = rows - 2 - tracks.pooled((tracks.frames > 0).astype(np.float64))  # a centre, and a radius for each marker
    inverse = _inverse(normal)
    correction = np.where(left > 0, rows / np.maximum(left, 1), np.nan)
    return np.asarray(correction[:, None, None] * inverse @ spread @ inverse)


def _inverse(normal: FloatArray) -> FloatArray:
    """(G, 2, 2) inverses, NaN where there is none."""
    xx, xy, yy = normal[:, 0, 0], normal[:, 0, 1], normal[:, 1, 1]
    determinant = xx * yy - xy**2
    regular = determinant > _FLAT * (xx + yy) ** 2
    adjugate = np.stack([np.stack([yy, -xy], axis=1), np.stack([-xy, xx], axis=1)], axis=1)
    return np.asarray(adjugate / np.where(regular, determinant, np.nan)[:, None, None])


def _solved(normal: FloatArray, pull: FloatArray) -> ComplexArray:
    """(G,) solutions as complex numbers."""
    solution = np.einsum("gij,gj->gi", _inverse(normal), pull)
    return np.asarray(solution[:, 0] + 1j * solution[:, 1])


def _quotient(above: ComplexArray, below: FloatArray, moments: FloatArray) -> ComplexArray:
    """(G,) centres from a circle's coefficients; NaN where second moments (G, 2, 2) are of a line or point."""
    known = np.isfinite(_inverse(moments)[:, 0, 0]) & (below != 0)
    return np.where(known, above / np.where(known, below, 1), np.nan + 0j)
