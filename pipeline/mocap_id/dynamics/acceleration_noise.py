"""Correlation between the acceleration errors of the joints.

The states have a standard deviation for each joint. But markers locate segments, and a joint angle is the difference of
two segments' angles, so neighbouring joints have opposite errors. Treating the joints as independent makes the variance
of the wrench several times too large. The covariance of the smoother follows from the chain: each joint is driven by
snap with spectral density Q, markers provide information at the rate Λ (Jᵀ J over all markers), and the error of a
smoothed state has the spectrum (ω⁸ Q⁻¹ + Λ)⁻¹. The covariance of the accelerations is its fourth moment over all
frequencies, which is proportional to

    Q^½ (Q^½ Λ Q^½)^(-3/8) Q^½.

Its diagonal reproduces the standard deviations of the smoother; the correlation is taken from it.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.composite_inertia import composite_inertia

_EXPONENT = -3.0 / 8.0
_LEAST = 1e-12  # of the largest eigenvalue: avoids a division by zero for a joint without markers


def acceleration_correlation(
    q: FloatArray, centres: FloatArray, segment: IntArray, local: FloatArray, snap: FloatArray
) -> FloatArray:
    """Return the correlation of the errors of the joint accelerations in every posture.

    Parameters
    ----------
    q : (T, n) array
        Joint angles, rad; NaN where unknown.
    centres : (n, 2) array
        Centre of each joint in the frame of the segment before it, m.
    segment : (M,) int array
        Segment of each marker.
    local : (M, 2) array
        Markers in their segment's frame, m.
    snap : (n,) array
        Standard deviation of each joint's process noise, in any common unit: only the ratios matter.

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
    correlation[known] = covariance / (size[:, :, None] * size[:, None, :])  # the outer Q^½ only scale each joint
    return correlation


def _information(q: FloatArray, centres: FloatArray, segment: IntArray, local: FloatArray) -> FloatArray:
    """Return Jᵀ J of the markers (eq. 2.47), (T, n, n), m²: the mass matrix of a chain with unit masses at them."""
    segments = len(centres) + 1

    def total(values: FloatArray) -> FloatArray:
        return np.bincount(segment, weights=values, minlength=segments).astype(np.float64)

    first = np.column_stack([total(local[:, 0]), total(local[:, 1])])
    return composite_inertia(q, centres, total(np.ones(len(local))), first, total(np.sum(local**2, axis=1))).torque
