"""Alternative estimators of joint states, for comparison: two averaged filter passes, a low-pass, a spline.

``two-filter`` is the thesis's method (ch. 3.2.6). The other two smooth the angles of single frames, joint by joint.
They do not use the uncertainty of an angle. They therefore bridge gaps up to a fixed time only, and give no standard
deviations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.errors import ConfigError
from mocap_id.estimation.filter_problem import ORDER, Anchors, FilterProblem, Track
from mocap_id.estimation.quintic_spline import fit_smoothing_spline

BRIDGE_LIMIT = 0.2  # longest gap, s, that the low-pass and the spline bridge

LEAST_SAMPLES = 12  # least number of angles between long gaps that the low-pass and the spline smooth

_REVERSED = np.array([1.0, -1.0, 1.0, -1.0])  # reversing time changes the sign of odd derivatives
_POLES = 2  # of one pass; both passes together have four, as is usual in movement analysis

Derivatives = Callable[[FloatArray, BoolArray, float], FloatArray]
"""Function from an angle (F,), rad, flags of its known samples (F,) and the time step, s, to the states (F, 4)."""


class AngleEstimate(NamedTuple):
    """Estimated states of all joints, from any method."""

    mean: FloatArray  # (F, n, 4) rad and s
    sd: FloatArray  # (F, n, 4) standard deviations; NaN if unknown
    used: BoolArray  # (F, M) markers used
    log_likelihood: float  # NaN if the method has none
    filled: BoolArray | None = None  # (F, n) states extrapolated backwards from later frames; None: no state


def average_two_passes(problem: FilterProblem, run_filter: Callable[[FilterProblem], Track]) -> AngleEstimate:
    """Return the average of a filter pass over the series and a pass over the reversed series (ch. 3.2.6).

    The errors of the two passes have an unknown correlation, because both use the frame itself. For any correlation,
    the standard deviation of the average is at most the mean of the two standard deviations. This bound is returned. A
    marker is ``used`` if one of the passes used it; the likelihood is that of the forward pass.
    """
    ahead = run_filter(problem)
    anchors = problem.anchors
    backwards = Anchors(anchors.angles[::-1], anchors.covariance[::-1], anchors.observed[::-1], anchors.used[::-1])
    back = run_filter(replace(problem, observed=problem.observed[::-1], anchors=backwards))
    mean, sd = ahead.by_joint()
    other, other_sd = (each[::-1] for each in back.by_joint())
    other = other * _REVERSED
    other[..., 0] -= 2.0 * np.pi * np.round((other[..., 0] - mean[..., 0]) / (2.0 * np.pi))
    return AngleEstimate(
        0.5 * (mean + other), 0.5 * (sd + other_sd), ahead.used | back.used[::-1], ahead.log_likelihood
    )


def smooth_butterworth(anchors: Anchors, dt: float, cutoff: float) -> AngleEstimate:
    """Smooth the angles of single frames by a zero-phase Butterworth low-pass, then differentiate them.

    ``cutoff`` is the cut-off of each of the two passes, Hz; both passes together halve the amplitude at this frequency.
    The derivatives are central differences. Long gaps are NaN, as are all standard deviations.

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

    return _smooth_joints(anchors, dt, derivatives)


def smooth_spline(anchors: Anchors, dt: float) -> AngleEstimate:
    """Smooth the angles of single frames by a quintic spline (ch. 5.5, :mod:`mocap_id.estimation.quintic_spline`).

    Long gaps are NaN, as are all standard deviations.
    """
    return _smooth_joints(anchors, dt, fit_smoothing_spline)


def _smooth_joints(anchors: Anchors, dt: float, derivatives: Derivatives) -> AngleEstimate:
    """Apply ``derivatives`` to each joint's angles between its long gaps; the result is NaN in these gaps."""
    mean = np.full((*anchors.angles.shape, ORDER), np.nan)
    for j in range(mean.shape[1]):
        seen = anchors.observed[:, j]
        angle = np.where(seen, anchors.angles[:, j], 0.0)
        angle[seen] = np.unwrap(angle[seen])
        for part in _find_stretches(seen, BRIDGE_LIMIT / dt):
            mean[part, j] = derivatives(angle[part], seen[part], dt)
    return AngleEstimate(mean, np.full(mean.shape, np.nan), anchors.used.copy(), np.nan)


def _find_stretches(seen: BoolArray, limit: float) -> Iterator[slice]:
    """Yield each stretch with enough samples that are ``seen`` (F,), and no gap of more than ``limit`` samples."""
    found = np.flatnonzero(seen)
    for part in np.split(found, np.flatnonzero(np.diff(found) > limit + 1) + 1):
        if len(part) >= LEAST_SAMPLES:
            yield slice(int(part[0]), int(part[-1]) + 1)
