"""Alternative estimators of joint states, for comparison: two averaged filter passes, a low-pass, a spline.

``two-filter`` is the thesis's method (ch. 3.2.6). The other two smooth the angles of single frames, joint by joint.
They do not use the uncertainty of an angle. They therefore bridge gaps up to a fixed time only, and give no standard
deviations.

The quintic smoothing spline θ(t) minimises Σ (y_k − θ(t_k))² + λ ∫ (d³θ/dt³)² dt for the samples y_k. Its stiffness λ
is chosen by generalised cross-validation. A cubic spline penalises the acceleration itself, which becomes piecewise
linear, and zero at the ends. The acceleration of the quintic spline is smooth, and need not be zero at the ends
(Woltring 1986).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.interpolate import BSpline, PchipInterpolator
from scipy.linalg import solveh_banded
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array, dia_array, diags_array

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import ConfigError
from mocap_id.estimation.filter_problem import ORDER, Anchors, FilterProblem, Track

BRIDGE_LIMIT = 0.2  # longest gap, s, that the low-pass and the spline bridge

LEAST_SAMPLES = 12  # least number of angles between long gaps that the low-pass and the spline smooth

_REVERSED = np.array([1.0, -1.0, 1.0, -1.0])  # reversing time changes the sign of odd derivatives
_POLES = 2  # of one pass; both passes together have four, as is usual in movement analysis


def average_two_passes(
    problem: FilterProblem, run_filter: Callable[[FilterProblem], Track]
) -> tuple[FloatArray, FloatArray, BoolArray, float]:
    """Return the average of a filter pass over the series and a pass over the reversed series (ch. 3.2.6).

    The errors of the two passes have an unknown correlation, because both use the frame itself. For any correlation,
    the standard deviation of the average is at most the mean of the two standard deviations. This bound is returned:
    states and standard deviations (F, n, 4), markers (F, M) that one of the passes used, and the log-likelihood of the
    forward pass.
    """
    ahead = run_filter(problem)
    anchors = problem.anchors
    backwards = Anchors(anchors.angles[::-1], anchors.covariance[::-1], anchors.observed[::-1], anchors.used[::-1])
    back = run_filter(replace(problem, observed=problem.observed[::-1], anchors=backwards))
    mean, sd = ahead.by_joint()
    other, other_sd = (each[::-1] for each in back.by_joint())
    other = other * _REVERSED
    other[..., 0] -= 2.0 * np.pi * np.round((other[..., 0] - mean[..., 0]) / (2.0 * np.pi))
    used = np.asarray(ahead.used | back.used[::-1])
    return 0.5 * (mean + other), 0.5 * (sd + other_sd), used, ahead.log_likelihood


def smooth_butterworth(anchors: Anchors, dt: float, cutoff: float) -> FloatArray:
    """Smooth the angles of single frames by a zero-phase Butterworth low-pass, and return the states (F, n, 4).

    ``cutoff`` is the cut-off of each of the two passes, Hz; both passes together halve the amplitude at this frequency.
    The derivatives are central differences. Long gaps are NaN. ConfigError is raised if the frame rate is too low.
    """
    if not cutoff < 0.5 / dt:
        raise ConfigError(
            f"ukf-smooth: butterworth_hz is {cutoff:g}, expected less than half the frame rate, {0.5 / dt:g} Hz"
        )
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415  it imports all of scipy.stats

    sections = butter(_POLES, cutoff, fs=1.0 / dt, output="sos")

    def derivatives(angle: FloatArray, seen: BoolArray, dt: float) -> FloatArray:
        frames = np.arange(len(angle))
        bridged = PchipInterpolator(frames[seen], angle[seen])(frames)
        pad = min(len(angle) - 1, round(1.0 / (cutoff * dt)))
        series = [sosfiltfilt(sections, bridged, padlen=pad)]
        for _ in range(ORDER - 1):
            series.append(np.gradient(series[-1], dt, edge_order=2))
        return np.stack(series, axis=-1)

    return smooth_joints(anchors, dt, derivatives)


def smooth_joints(anchors: Anchors, dt: float, fit: Callable[[FloatArray, BoolArray, float], FloatArray]) -> FloatArray:
    """Smooth the angles of single frames, joint by joint, and return the states (F, n, 4); long gaps are NaN.

    ``fit`` returns the states (f, 4) from an angle (f,), rad, flags of its known samples (f,) and the time step, s.
    """
    mean = np.full((*anchors.angles.shape, ORDER), np.nan)
    for j in range(mean.shape[1]):
        seen = anchors.observed[:, j]
        angle = np.where(seen, anchors.angles[:, j], 0.0)
        angle[seen] = np.unwrap(angle[seen])
        # the stretches with enough samples and without a long gap
        found = np.flatnonzero(seen)
        for own in np.split(found, np.flatnonzero(np.diff(found) > BRIDGE_LIMIT / dt + 1) + 1):
            if len(own) >= LEAST_SAMPLES:
                part = slice(int(own[0]), int(own[-1]) + 1)
                mean[part, j] = fit(angle[part], seen[part], dt)
    return mean


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
