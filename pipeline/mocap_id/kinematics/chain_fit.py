"""The recovered chain, and the choice of its segment frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray


@dataclass(frozen=True)
class ChainFit:
    """The chain as recovered from the markers; segment frames are final only after :func:`fix_gauge`.

    Parameters
    ----------
    centres : (n,) complex array
        Joint j's centre in the frame of segment j-1, m.
    local : (M,) complex array
        Marker coordinates in their segment's frame, m; base markers in the plane frame.
    segment : (M,) int array
        Segment of each marker, 0 = base.
    angles : (F, n) array
        Absolute segment angles in the frames used, rad; NaN where a frame was not used.
    covariance : (n, 2, 2) array
        Of each centre, m^2: sandwich over stretches of time, so that residuals may be correlated within them, and
        what skin that slips with the angle may add.
    length_sd : (n - 1,) array
        Standard deviations of the lengths of segments 1 … n-1, m.
    residual : (M,) array
        rms residual of each marker, m.
    arcs : (n,) array
        Relative angle each joint travelled, 2.5 to 97.5 % quantile, rad.
    iterations : int
        Gauss-Newton steps taken.
    """

    centres: ComplexArray
    local: ComplexArray
    segment: IntArray
    angles: FloatArray
    covariance: FloatArray
    length_sd: FloatArray
    residual: FloatArray
    arcs: FloatArray
    iterations: int = 0

    @property
    def lengths(self) -> FloatArray:
        """(n - 1,) distances between the joints of segments 1 … n-1, m."""
        return np.asarray(np.abs(self.centres[1:]))


def fix_gauge(fit: ChainFit) -> ChainFit:
    """Turn every segment frame so that +Y points to the next joint, on the last segment to its markers' centroid."""
    joints = len(fit.centres)
    tip = fit.local[fit.segment == joints].mean()
    towards = np.append(fit.centres[1:], tip)
    turn = np.exp(1j * (np.pi / 2 - np.angle(towards)))
    centres = fit.centres.copy()
    centres[1:] *= turn[:-1]
    per_segment = np.concatenate([[1], turn])
    covariance = fit.covariance.copy()
    for joint in range(1, joints):
        rotation = _matrix(turn[joint - 1])
        covariance[joint] = rotation @ fit.covariance[joint] @ rotation.T
    return replace(
        fit,
        centres=centres,
        local=fit.local * per_segment[fit.segment],
        angles=continuous(fit.angles - np.angle(turn)),
        covariance=covariance,
    )


def joint_angles(absolute: FloatArray) -> FloatArray:
    """(F, n) angles of each segment relative to its parent from the absolute ones, rad."""
    return np.diff(absolute, axis=1, prepend=0.0)


def length_sd(centres: ComplexArray, covariance: FloatArray) -> FloatArray:
    """(n - 1,) standard deviation of |c_j| for joints 2 … n."""
    along = np.stack([centres.real, centres.imag], axis=1)[1:] / np.abs(centres[1:])[:, None]
    return np.asarray(np.sqrt(np.einsum("ji,jik,jk->j", along, covariance[1:], along)))


def continuous(angles: FloatArray) -> FloatArray:
    """Angles (F, n) without jumps over the frames that are known, starting in (-pi, pi]."""
    known = np.isfinite(angles).all(axis=1)
    out = np.full(angles.shape, np.nan)
    out[known] = np.unwrap(angles[known], axis=0)
    return np.asarray(out - 2 * np.pi * np.round(out[known][0] / (2 * np.pi)))


def _matrix(turn: complex) -> FloatArray:
    """(2, 2) rotation matrix of a unit complex number."""
    return np.array([[turn.real, -turn.imag], [turn.imag, turn.real]])
