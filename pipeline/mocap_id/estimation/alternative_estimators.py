"""Alternative estimators of joint states, for comparison: two averaged filter passes, a low-pass, a spline.

``two-filter`` is the thesis's method (ch. 3.2.6). The other two smooth the angles of single frames, joint by joint.
They do not use the uncertainty of an angle. They therefore bridge gaps up to a fixed time only, and give no standard
deviations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.interpolate import PchipInterpolator

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
