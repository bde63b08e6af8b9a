"""Correlation between the acceleration errors of the joints.

The states have a standard deviation for each joint. But markers locate segments, and a joint angle is the difference of
two segments' angles. Neighbouring joints therefore have opposite errors. If these errors were taken as independent, the
variance of the wrench would be several times too large. The correlation follows from the smoother. Each joint is driven
by snap with spectral density Q, and markers provide information at the rate Λ (Jᵀ J over all markers). The error of a
smoothed state then has the spectrum (ω⁸ Q⁻¹ + Λ)⁻¹. The covariance of the accelerations is the fourth moment of this
spectrum, which is proportional to

    Q^½ (Q^½ Λ Q^½)^(-3/8) Q^½.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.composite_inertia import composite_inertia

_EXPONENT = -3.0 / 8.0
_LEAST = 1e-12  # fraction of the largest eigenvalue: avoids a division by zero for a joint without markers


def correlate_errors(
    q: FloatArray, centres: FloatArray, segment: IntArray, local: FloatArray, snap: FloatArray
) -> FloatArray:
    """Return the correlation (T, n, n) of the errors of the joint accelerations in every posture.

    Parameters
    ----------
    q : (T, n) array
        Joint angles, rad; NaN where missing. If one is missing, the correlation (n, n) of this sample is NaN.
    segment : (M,) int array
        Segment of each marker.
    local : (M, 2) array
        Markers in the frame of their segment, m.
    snap : (n,) array
        Standard deviation of each joint's process noise, in any common unit, because only the ratios have an effect.
    """
    correlation = np.full((*q.shape, q.shape[1]), np.nan)
    known = np.isfinite(q).all(axis=1)
    scale = snap / np.max(snap)
    values, vectors = np.linalg.eigh(_compute_information(q[known], centres, segment, local) * scale[:, None] * scale)
    values = np.maximum(values, _LEAST * values[:, -1:])
    covariance = (vectors * values[:, None, :] ** _EXPONENT) @ np.swapaxes(vectors, 1, 2)
    size = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    correlation[known] = covariance / (
        size[:, :, None] * size[:, None, :]
    )  # the outer factors Q^½ only scale the joints
    return correlation


def _compute_information(q: FloatArray, centres: FloatArray, segment: IntArray, local: FloatArray) -> FloatArray:
    """Return Jᵀ J of the markers (eq. 2.47), (T, n, n), m²: the mass matrix of a chain with unit masses at markers."""
    segments = len(centres) + 1

    def sum_by_segment(values: FloatArray) -> FloatArray:
        return np.bincount(segment, weights=values, minlength=segments).astype(np.float64)

    first = np.column_stack([sum_by_segment(local[:, 0]), sum_by_segment(local[:, 1])])
    return composite_inertia(
        q, centres, sum_by_segment(np.ones(len(local))), first, sum_by_segment(np.sum(local**2, axis=1))
    ).torque
