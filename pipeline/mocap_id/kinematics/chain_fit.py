"""Fitted planar chain, and the orientation of its segment frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray


@dataclass(frozen=True)
class ChainFit:
    """Planar chain fitted to markers. Segment frames are final only after :func:`orient_frames`."""

    centres: ComplexArray  # (n,) centre of joint j in the frame of segment j-1, m
    local: ComplexArray  # (M,) marker coordinates in their segment's frame, m; base markers in the plane frame
    segment: IntArray  # (M,) segment of each marker, 0 = base
    angles: FloatArray  # (F, n) absolute segment angles, rad; NaN in frames that were not used
    covariance: FloatArray  # (n, 2, 2) covariance of each centre from camera noise and sliding skin, m^2
    length_sd: FloatArray  # (n - 1,) standard deviations of the lengths of segments 1 … n-1, m
    residual: FloatArray  # (M,) rms residual of each marker, m
    arcs: FloatArray  # (n,) 2.5 to 97.5 % range of each joint angle, rad
    iterations: int = 0  # number of Gauss-Newton steps

    @property
    def lengths(self) -> FloatArray:
        """Lengths (n - 1,) of segments 1 … n-1, m: the distances between neighbouring joints."""
        return np.asarray(np.abs(self.centres[1:]))


def orient_frames(fit: ChainFit) -> ChainFit:
    """Return the fit with segment frames rotated so that +Y points to the next joint.

    In the last segment, +Y points to the markers' centroid.
    """
    joints = len(fit.centres)
    tip = fit.local[fit.segment == joints].mean()
    towards = np.append(fit.centres[1:], tip)
    turn = np.exp(1j * (np.pi / 2 - np.angle(towards)))
    centres = fit.centres.copy()
    centres[1:] *= turn[:-1]
    per_segment = np.concatenate([[1], turn])
    covariance = fit.covariance.copy()
    for joint in range(1, joints):
        c, s = turn[joint - 1].real, turn[joint - 1].imag
        rotation = np.array([[c, -s], [s, c]])
        covariance[joint] = rotation @ fit.covariance[joint] @ rotation.T
    return replace(
        fit,
        centres=centres,
        local=fit.local * per_segment[fit.segment],
        angles=unwrap_angles(fit.angles - np.angle(turn)),
        covariance=covariance,
    )


def joint_angles(absolute: FloatArray) -> FloatArray:
    """Return the angles (F, n) of each segment relative to its parent, rad, from the absolute angles."""
    return np.diff(absolute, axis=1, prepend=0.0)


def length_sd(centres: ComplexArray, covariance: FloatArray) -> FloatArray:
    """Return the standard deviations (n - 1,) of the distances between neighbouring joints, m."""
    along = np.stack([centres.real, centres.imag], axis=1)[1:] / np.abs(centres[1:])[:, None]
    return np.asarray(np.sqrt(np.einsum("ji,jik,jk->j", along, covariance[1:], along)))


def unwrap_angles(angles: FloatArray) -> FloatArray:
    """Return angles (F, n), rad, without jumps of 2 pi between the frames that are not NaN, starting in [-pi, pi]."""
    known = np.isfinite(angles).all(axis=1)
    out = np.full(angles.shape, np.nan)
    out[known] = np.unwrap(angles[known], axis=0)
    return np.asarray(out - 2 * np.pi * np.round(out[known][0] / (2 * np.pi)))
