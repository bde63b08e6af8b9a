"""How the errors of neighbouring joints' accelerations go together.

The states come with a standard deviation a joint. Markers place segments, though, and an angle between two segments is
a difference: what one joint has too much its neighbour has too little, so that adding up the joints' variances as if
they were independent makes the wrench's several times too large. The smoother's own covariance follows from the chain:
snap of spectral density Q drives each joint, markers give information at the rate Λ (Jᵀ J over all markers), and the
error of a smoothed state has the spectrum (ω⁸ Q⁻¹ + Λ)⁻¹. Its fourth moment over all frequencies, the covariance of the
accelerations, is proportional to

    Q^½ (Q^½ Λ Q^½)^(-3/8) Q^½.

Its diagonal reproduces the smoother's standard deviations; the correlation is taken from it.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.composite import composite

_EXPONENT = -3.0 / 8.0
_LEAST = 1e-12  # of the largest eigenvalue: a joint that no marker shows must not divide by zero


def acceleration_correlation(
    q: FloatArray, centres: FloatArray, segment: IntArray, local: FloatArray, snap: FloatArray
) -> FloatArray:
    """Correlation of the joint accelerations' errors in every posture.

    Parameters
    ----------
    q : (T, n) array
        Joint angles, rad; NaN where unknown.
    centres : (n, 2) array
        Joint centres in the segment before, m.
    segment : (M,) int array
    local : (M, 2) array
        Markers in their segment's frame, m.
    snap : (n,) array
        Standard deviation of each joint's process noise, in any common unit: only the ratios count.

    Returns
    -------
    (T, n, n) array
        NaN where an angle is unknown.
    """
    correlation = np.full((*q.shape, q.shape[1]), np.nan)
    known = np.isfinite(q).all(axis=1)
    scale = snap / np.max(snap)
    values, vectors = np.linalg.eigh(_information(q[known], centres, segment, local) * scale[:, None] * scale)
    values = np.maximum(values, _LEAST * values[:, -1:])
    covariance = (vectors * values[:, None, :] ** _EXPONENT) @ np.swapaxes(vectors, 1, 2)
    size = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    correlation[known] = covariance / (size[:, :, None] * size[:, None, :])  # the outer Q^½ are a scale a joint
    return correlation


def _information(q: FloatArray, centres: FloatArray, segment: IntArray, local: FloatArray) -> FloatArray:
    """Jᵀ J over the markers' Jacobian (eq. 2.47), (T, n, n), m²: the mass matrix of a chain of unit masses there."""
    segments = len(centres) + 1

    def total(values: FloatArray) -> FloatArray:
        return np.bincount(segment, weights=values, minlength=segments).astype(np.float64)

    first = np.column_stack([total(local[:, 0]), total(local[:, 1])])
    return composite(q, centres, total(np.ones(len(local))), first, total(np.sum(local**2, axis=1))).torque
