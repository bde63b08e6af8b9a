"""Reference engine: filterpy's unscented Kalman filter, and a smoother in plain numpy.

It is slow and serves to verify the compiled engine.

filterpy leaves three tasks to its caller. A missing marker must be removed from measurement, noise and measurement
function, because one NaN spoils the state. The first frame needs explicit sigma points, because ``update`` uses the
points of the preceding ``predict``. The smoother of filterpy has one process noise for all steps and cannot start
joints again, so it is not used.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from scipy.interpolate import BSpline, PchipInterpolator
from scipy.linalg import solveh_banded
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array, dia_array, diags_array

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import ConfigError, NumericalError
from mocap_id.estimation.filter_kernels import ENOUGH
from mocap_id.estimation.filter_problem import (
    ANCHOR_SD,
    ORDER,
    START_SD,
    Anchors,
    FilterProblem,
    Track,
    joint_noise,
    joint_transition,
    start_sd,
)
from mocap_id.geometry.planar import marker_positions


def filter_slowly(problem: FilterProblem) -> Track:
    """Run the filter over all frames, and return the filtered states.

    Raise NumericalError if a covariance is not positive definite.
    """
    frames, markers = problem.observed.shape[:2]
    n = problem.joints
    mean, covariance = np.empty((frames, 4 * n)), np.empty((frames, 4 * n, 4 * n))
    used, restarted = np.zeros((frames, markers), dtype=np.bool_), np.zeros((frames, n), dtype=np.bool_)
    ukf, last_angle, log_likelihood = _make_filter(problem), problem.anchors.angles[0].copy(), 0.0
    own = problem.segment[:, None] == np.arange(1, n + 1)  # (M, n)
    failing = np.zeros(n, dtype=np.int64)  # successive frames in which over half of a segment's markers fail
    for k in range(frames):
        try:
            if k > 0:
                ukf.predict()
            diverged = (failing > 0) & bool((failing > problem.patience).any())
            lost = restarted[k] = (k == 0) | (np.diag(ukf.P)[:n] > START_SD[0] ** 2) | diverged
            failing[lost] = 0
            # lost joints start at their last angle, at rest, with their initial covariance
            rows = np.tile(lost, 4)
            ukf.P[rows, :] = 0.0
            ukf.P[:, rows] = 0.0
            ukf.P[rows, rows] = np.repeat(start_sd(problem.dt) ** 2, n)[rows]
            ukf.x[rows] = np.concatenate([last_angle, np.zeros(3 * n)])[rows]
            ukf.sigmas_f = ukf.points_fn.sigma_points(ukf.x, ukf.P)
            gained, used[k] = _measure(ukf, problem, k)
        except np.linalg.LinAlgError as error:
            raise NumericalError(
                f"the filter's covariance is not positive definite at sample {k} of {frames}"
            ) from error
        log_likelihood += gained
        # a frame in which no marker of the segment is visible does not count
        seen = (own & np.isfinite(problem.observed[k]).all(axis=-1)[:, None]).sum(axis=0)
        passed = (own & used[k][:, None]).sum(axis=0)
        failing = np.asarray(np.where(seen > 0, np.where(2 * passed < seen, failing + 1, 0), failing))
        last_angle = np.where(problem.anchors.observed[k] & (failing == 0), ukf.x[:n], last_angle)
        mean[k], covariance[k] = ukf.x, ukf.P
    return Track(mean, covariance, used, restarted, log_likelihood)


def smooth_slowly(problem: FilterProblem, track: Track) -> Track:
    """Run the Rauch–Tung–Striebel smoother over a filtered track, and return the smoothed states as a new track."""
    n = problem.joints
    f, q = joint_transition(problem.dt, n), joint_noise(problem.dt, problem.density)
    start = np.repeat(start_sd(problem.dt) ** 2, n)
    mean, covariance = track.mean.copy(), track.covariance.copy()
    for k in range(len(mean) - 2, -1, -1):
        predicted = f @ covariance[k] @ f.T + q
        cross = covariance[k] @ f.T
        lost = np.tile(track.restarted[k + 1], 4)
        cross[:, lost] = 0.0
        predicted[lost, :] = 0.0
        predicted[:, lost] = 0.0
        predicted[lost, lost] = start[lost]
        gain = np.linalg.solve(predicted, cross.T).T
        mean[k] += gain @ (mean[k + 1] - f @ mean[k])
        keep = np.eye(4 * n) - gain @ f
        covariance[k] = keep @ covariance[k] @ keep.T + gain @ (covariance[k + 1] + q) @ gain.T
    return Track(mean, covariance, track.used, track.restarted, track.log_likelihood)


def _make_filter(problem: FilterProblem) -> UnscentedKalmanFilter:
    size, points = 4 * problem.joints, problem.sigma_points
    f = joint_transition(problem.dt, problem.joints)
    ukf = UnscentedKalmanFilter(
        dim_x=size,
        dim_z=2 * len(problem.segment),
        dt=problem.dt,
        fx=lambda x, dt: f @ x,
        hx=lambda x, markers: _forward(problem, x, markers).ravel(),
        points=MerweScaledSigmaPoints(size, points.alpha, points.beta, points.kappa),
    )
    ukf.Q = joint_noise(problem.dt, problem.density)
    ukf.P = np.zeros((size, size))
    return ukf


def _forward(problem: FilterProblem, states: FloatArray, markers: BoolArray) -> FloatArray:
    """Return the positions (..., m, 2) of the m chosen markers (eq. 3.18) for states (..., 4n)."""
    angles = states[..., : problem.joints]
    return marker_positions(angles, problem.centres, problem.segment[markers], problem.local[markers])


def _measure(ukf: UnscentedKalmanFilter, problem: FilterProblem, k: int) -> tuple[float, BoolArray]:
    """Update the filter with frame k; return the increase of the log-likelihood and the markers used (M,)."""
    visible = np.isfinite(problem.observed[k]).all(axis=-1)
    uncertain = np.flatnonzero(np.diag(ukf.P)[: problem.joints] > ANCHOR_SD**2)
    if uncertain.size and np.any(visible & (problem.segment > uncertain[0])):
        if not problem.anchors.observed[k].any():
            return 0.0, np.zeros_like(visible)
        taken = _anchor(ukf, problem.anchors.angles[k], problem.anchors.covariance[k], problem.gate)
        return 0.0, problem.anchors.used[k] & taken
    # the gate around the prediction
    points = _forward(problem, ukf.sigmas_f, visible)  # (2L + 1, m, 2)
    expected = np.einsum("s,smi->mi", ukf.Wm, points)
    deviation = points - expected
    spread = np.einsum("s,smi,smj->mij", ukf.Wc, deviation, deviation)
    spread += problem.gate_variance[visible, None, None] * np.eye(2)
    innovation = problem.observed[k, visible] - expected
    squared = np.einsum("mi,mi->m", innovation, np.linalg.solve(spread, innovation[..., None])[..., 0])
    passed = visible.copy()
    passed[visible] = squared <= problem.gate**2
    own = problem.segment[:, None] == np.arange(1, problem.joints + 1)  # (M, n)
    seen, through, fitting = ((own & each[:, None]).sum(axis=0) for each in (visible, passed, problem.anchors.used[k]))
    lost = problem.anchors.observed[k] & (seen >= ENOUGH) & (2 * through < seen) & (seen < 2 * fitting)
    if lost.any() and np.count_nonzero(problem.anchors.used[k]) > np.count_nonzero(passed):
        _anchor(ukf, problem.anchors.angles[k], problem.anchors.covariance[k], np.inf)
        return 0.0, problem.anchors.used[k].copy()
    if not passed.any():
        return 0.0, passed
    noise = np.diag(np.repeat(problem.variance[passed], 2))
    ukf.update(problem.observed[k, passed].ravel(), R=noise, markers=passed)
    return float(ukf.log_likelihood), passed


def _anchor(ukf: UnscentedKalmanFilter, angles: FloatArray, noise: FloatArray, gate: float) -> bool:
    """Update the filter with the angles (n,) of one frame and their covariance; return whether they passed the gate.

    Whole rotations are added to the angles to bring them near the state. The update is linear, in Joseph form.
    """
    n, size = len(angles), len(ukf.x)
    h = np.eye(n, size)
    innovation = angles - ukf.x[:n]
    innovation -= 2.0 * np.pi * np.round(innovation / (2.0 * np.pi))
    spread = ukf.P[:n, :n] + noise
    if innovation @ np.linalg.solve(spread, innovation) > gate**2:
        return False
    gain = np.linalg.solve(spread, ukf.P[:n]).T
    keep = np.eye(size) - gain @ h
    ukf.x = ukf.x + gain @ innovation
    ukf.P = keep @ ukf.P @ keep.T + gain @ noise @ gain.T
    return True


BRIDGE_LIMIT = 0.2  # longest gap, s, that the low-pass and the spline bridge

LEAST_SAMPLES = 12  # least number of angles between long gaps that the low-pass and the spline smooth

_REVERSED = np.array([1.0, -1.0, 1.0, -1.0])  # reversing time changes the sign of odd derivatives
_POLES = 2  # of one pass; both passes together have four, as is usual in movement analysis


def average_two_passes(
    problem: FilterProblem, run_filter: Callable[[FilterProblem], Track]
) -> tuple[FloatArray, FloatArray, BoolArray, float]:
    """Return the average of a filter pass over the series and a pass over the reversed series (ch. 3.2.6).

    The errors of the two passes have an unknown correlation, because both use the frame itself. For any correlation,
    the standard deviation of the average is at most the mean of the two standard deviations. This bound is returned.

    Returns
    -------
    mean, sd : (F, n, 4) arrays
        States and standard deviations.
    used : (F, M) bool array
        Markers that one of the passes used.
    log_likelihood : float
        Of the forward pass.
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
    The derivatives are central differences. Long gaps are NaN.

    Raises
    ------
    ConfigError
        The frame rate is too low for the cut-off.
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
