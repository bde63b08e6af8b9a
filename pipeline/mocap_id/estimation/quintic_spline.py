"""Quintic smoothing spline whose stiffness is chosen by generalised cross-validation, for reliable accelerations.

The spline θ(t) minimises Σ (y_k − θ(t_k))² + λ ∫ (d³θ/dt³)² dt for the samples y_k and the stiffness λ. A cubic spline
penalises the acceleration itself, which becomes piecewise linear, and zero at the ends. The acceleration of the quintic
spline is smooth, and need not be zero at the ends (Woltring 1986).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import solveh_banded
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array, dia_array, diags_array

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.filter_problem import ORDER

DEGREE = 5
_PENALISED = 3  # derivative
_KNOT_RATE = 200.0  # Hz, most knots per second: enough for joints, and well conditioned at any frame rate
_LOG_STIFFNESS = (-7.0, 28.0)  # natural logarithm of λ for unit knot spacing
_TOLERANCE = 0.01


def fit_smoothing_spline(angle: FloatArray, seen: BoolArray, dt: float) -> FloatArray:
    """Return the smoothing spline of the known samples as states (F, 4): angle, velocity, acceleration, jerk.

    ``angle`` (F,), rad, is unwrapped. ``seen`` (F,) is true for the known samples, which must be more than 10, and
    ``dt`` is the time step, s.
    """
    frames = len(angle)
    spacing = max(1.0, 1.0 / (_KNOT_RATE * dt))  # samples
    intervals = math.ceil((frames - 1) / spacing)
    spacing = (frames - 1) / intervals
    knots = np.arange(-DEGREE, intervals + DEGREE + 1, dtype=np.float64)
    position = np.minimum(np.arange(frames) / spacing, intervals)
    basis = csr_array(BSpline.design_matrix(position, knots, DEGREE))
    data = csr_array(basis[seen])
    middle = float(np.mean(angle[seen]))  # subtracted to avoid cancellation in the sums of squares
    given = angle[seen] - middle
    normal, penalty, moment = _bands(dia_array(data.T @ data)), _bands(_penalty(intervals)), np.asarray(data.T @ given)

    def coefficients(log_stiffness: float) -> FloatArray:
        return np.asarray(solveh_banded(normal + math.exp(log_stiffness) * penalty, moment, lower=True))

    def score(log_stiffness: float) -> float:
        misfit = given - data @ coefficients(log_stiffness)
        left = 1.0 - _freedom(math.exp(log_stiffness), intervals, len(given)) / len(given)
        return math.log(float(misfit @ misfit) + 1e-300) - 2.0 * math.log(max(left, 1e-12))

    best = minimize_scalar(score, bounds=_LOG_STIFFNESS, method="bounded", options={"xatol": _TOLERANCE})
    spline = BSpline(knots, coefficients(float(best.x)), DEGREE)
    states = np.stack([spline(position, nu=d) / (spacing * dt) ** d for d in range(ORDER)], axis=-1)
    states[:, 0] += middle
    return np.asarray(states)


def _penalty(intervals: int) -> dia_array:
    """Return the matrix of ∫ (third derivative)² as a quadratic form in the coefficients, for unit knot spacing.

    The third derivative is the quadratic spline whose coefficients are the third differences. Three Gauss points per
    interval integrate its square exactly.
    """
    size = intervals + DEGREE
    steps = [(-1.0) ** (_PENALISED - k) * math.comb(_PENALISED, k) for k in range(_PENALISED + 1)]
    difference = diags_array(steps, offsets=range(_PENALISED + 1), shape=(size - _PENALISED, size))
    order = DEGREE - _PENALISED
    knots = np.arange(-order, intervals + order + 1, dtype=np.float64)
    at, weight = np.polynomial.legendre.leggauss(order + 1)
    points = (np.arange(intervals)[:, None] + 0.5 * (1.0 + at)).ravel()
    basis = csr_array(BSpline.design_matrix(points, knots, order)) @ difference
    return dia_array(basis.T @ diags_array(np.tile(0.5 * weight, intervals)) @ basis)


def _bands(matrix: dia_array) -> FloatArray:
    size = matrix.shape[0]
    bands = np.zeros((DEGREE + 1, size))
    for k in range(DEGREE + 1):
        bands[k, : size - k] = matrix.diagonal(-k)
    return bands


def _freedom(stiffness: float, intervals: int, seen: int) -> float:
    """Return the trace of the smoother matrix (degrees of freedom), approximated by sine modes.

    For N samples on K intervals, smoothing with the stiffness λ multiplies mode k by 1 / (1 + λ (π k / K)⁶ K / N).
    Polynomials up to the second degree are not changed.
    """
    free_ends = 0.5 * (_PENALISED - 1)  # free ends raise the frequencies; those of a free beam have k + 1/2
    frequency = math.pi * (np.arange(1, min(seen, intervals + DEGREE) - _PENALISED + 1) + free_ends) / intervals
    passed = 1.0 / (1.0 + stiffness * frequency ** (2 * _PENALISED) * intervals / seen)
    return _PENALISED + float(passed.sum())
