"""The fitted chain and the orientation of its segment frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray


@dataclass(frozen=True)
class ChainFit:
    """A chain fitted to markers. Segment frames are final only after :func:`orient_frames`.

    Parameters
    ----------
    centres : (n,) complex array
        Centre of joint j in the frame of segment j-1, m.
    local : (M,) complex array
        Marker coordinates in their segment's frame, m; base markers in the plane frame.
    segment : (M,) int array
        Segment of each marker, 0 = base.
    angles : (F, n) array
        Absolute segment angles, rad; NaN in frames that were not used.
    covariance : (n, 2, 2) array
        Covariance of each centre, m^2: a sandwich over blocks of time, which allows correlated residuals within a
        block, plus the effect of skin that slides with the angle.
    length_sd : (n - 1,) array
        Standard deviations of the lengths of segments 1 … n-1, m.
    residual : (M,) array
        rms residual of each marker, m.
    arcs : (n,) array
        2.5 to 97.5 % range of each joint's relative angle, rad.
    iterations : int
        Number of Gauss-Newton steps.
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
        """Return the distances (n - 1,) between the joints of segments 1 … n-1, m."""
        return np.asarray(np.abs(self.centres[1:]))


def orient_frames(fit: ChainFit) -> ChainFit:
    """Turn each segment frame so that +Y points to the next joint (last segment: to its markers' centroid)."""
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
        angles=unwrap_angles(fit.angles - np.angle(turn)),
        covariance=covariance,
    )


def joint_angles(absolute: FloatArray) -> FloatArray:
    """Return the angles (F, n) of each segment relative to its parent from the absolute angles, rad."""
    return np.diff(absolute, axis=1, prepend=0.0)


def length_sd(centres: ComplexArray, covariance: FloatArray) -> FloatArray:
    """Return the standard deviations (n - 1,) of |c_j| for joints 2 … n."""
    along = np.stack([centres.real, centres.imag], axis=1)[1:] / np.abs(centres[1:])[:, None]
    return np.asarray(np.sqrt(np.einsum("ji,jik,jk->j", along, covariance[1:], along)))


def unwrap_angles(angles: FloatArray) -> FloatArray:
    """Return the angles (F, n) unwrapped over the known frames, starting in (-pi, pi]."""
    known = np.isfinite(angles).all(axis=1)
    out = np.full(angles.shape, np.nan)
    out[known] = np.unwrap(angles[known], axis=0)
    return np.asarray(out - 2 * np.pi * np.round(out[known][0] / (2 * np.pi)))


def _matrix(turn: complex) -> FloatArray:
    return np.array([[turn.real, -turn.imag], [turn.imag, turn.real]])
