"""Marker and process noise by maximum likelihood, from the angles of single frames.

To first order, the likelihood of the markers has two factors. The residuals of the chain within each frame determine
the marker noise alone. The angles of the frames, whose covariance follows from the marker noise, are linear
measurements of the process and determine the density of its noise. This density is estimated joint by joint from the
marginal variance of each angle. For every trial value, a filter with four states and a scalar measurement gives the
likelihood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from mocap_id.arrays import BoolArray, FloatArray, chunks
from mocap_id.compilation import compiled
from mocap_id.estimation.filter_problem import ORDER, Anchors, noise_shape, start_sd, transition
from mocap_id.estimation.inverse_kinematics import FrameAngles

SIGMA_V_BOUNDS = (1.0, 1e6)  # search range of the snap's standard deviation over one frame, rad/s^4

_LEVER_SQUARED = 1e-4  # m^2; an angle uses a degree of freedom if its markers have a lever above 1 cm
OUTLIER_SHARE = 1e-3
"""Fraction of outliers among the angles of single frames; jumps count as outliers, not as process noise."""

_STEP = 0.25  # s; time between angles that are compared to detect motion
_RESTING = 0.1  # of a joint's largest change in this time; a joint with a smaller change is at rest
_LEAST_CHANGE = 0.05  # rad; a joint whose largest change is less does not move
_LARGEST = 0.99  # quantile that counts as the largest change
_LEAST_MOTION = 0.25  # fraction of frames with motion from which all frames count
_NEAR = 2  # number of times _STEP before and after motion that count as motion
_SETTLE = 10  # innovations that determine the unknown start; they are not counted


@dataclass(frozen=True)
class FilterNoise:
    """Measurement and process noise of the filter."""

    marker_sd: float  # standard deviation of a marker's coordinate, m: camera noise and soft tissue together
    sigma_v: FloatArray  # (n,) sd of each joint's snap held over one frame, rad/s^4; its density is sigma_v^2 dt


def estimate_marker_noise(frames: FrameAngles, floor: float) -> float:
    """Return an unbiased estimate of the marker noise, m, from the residuals of single frames, or ``floor`` if larger.

    The degrees of freedom used by the angles are subtracted. The floor is needed for filtered or synthetic recordings,
    which have almost no noise.
    """
    sound: BoolArray = np.all(frames.reliable, axis=1)
    n, lost_freedom = frames.information.shape[1], np.empty(len(sound))
    for s in chunks(len(sound)):
        kept = np.linalg.inv(np.eye(n) + frames.information[s] / _LEVER_SQUARED)
        lost_freedom[s] = n - np.trace(kept, axis1=1, axis2=2)
    freedom = 2.0 * np.count_nonzero(frames.used[sound]) - float(np.sum(lost_freedom[sound]))
    return max(floor, math.sqrt(frames.squares / freedom)) if freedom >= 1.0 else floor


def estimate_process_noise(anchors: Anchors, dt: float) -> FloatArray:
    """Return the standard deviation (n,) of each joint's snap, held over one frame, rad/s^4, for a time step in s.

    The search is limited to :data:`SIGMA_V_BOUNDS`. With too few observed angles the result is the upper bound, so that
    the states follow the angles of single frames. Frames at rest count only if rest takes at most three quarters of the
    time, because rest would make the estimate too small for the motion.
    """
    step, shape, start = transition(dt)[0], noise_shape(dt), start_sd(dt) ** 2
    low, high = np.log(SIGMA_V_BOUNDS)
    counted = anchors.observed & _find_motion(anchors, dt)[:, None]
    found = np.empty(anchors.angles.shape[1])
    for j in range(len(found)):
        angle = np.where(counted[:, j], anchors.angles[:, j], np.nan)
        variance = np.ascontiguousarray(anchors.covariance[:, j, j])

        def cost(log_sigma: float, angle: FloatArray = angle, variance: FloatArray = variance) -> float:
            process = math.exp(2.0 * log_sigma) * dt * shape
            return -log_likelihood(angle, variance, step, process, start, OUTLIER_SHARE)

        best = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 0.01})
        found[j] = math.exp(best.x)
    return found


def _find_motion(anchors: Anchors, dt: float) -> BoolArray:
    """Return the frames (F,) near motion; all frames unless rest takes most of the time."""
    step = max(1, round(_STEP / dt))
    angles = np.where(anchors.observed, anchors.angles, np.nan)[::step]
    changes = np.abs(np.diff(angles, axis=0, prepend=np.nan))
    if len(changes) < 2 or not np.isfinite(changes).any(axis=0).all():
        return np.ones(len(anchors.observed), dtype=np.bool_)
    changes = np.where(np.isfinite(changes), changes, 0.0)
    largest = np.quantile(changes, _LARGEST, axis=0)
    moving = (changes > _RESTING * np.where(largest > _LEAST_CHANGE, largest, np.inf)).any(axis=1)
    if moving.mean() >= _LEAST_MOTION or not moving.any():
        return np.ones(len(anchors.observed), dtype=np.bool_)
    near = np.convolve(moving, np.ones(2 * _NEAR + 1), mode="same") > 0
    return np.asarray(np.repeat(near, step)[: len(anchors.observed)])


@compiled
def log_likelihood(  # noqa: PLR0917
    angle: FloatArray, variance: FloatArray, step: FloatArray, process: FloatArray, start: FloatArray, outliers: float
) -> float:
    """Return the log-likelihood of the innovations of one angle for the process model (eq. 3.17), robust to outliers.

    ``angle`` (F,), rad, is NaN where unobserved, and ``variance`` (F,) is its noise, rad^2. ``step`` (4,) is dt^k / k!,
    and ``process`` (4, 4) is the process noise of a step. ``start`` (4,) are the initial variances of the state, which
    are used again after a gap if the variance of the angle has become larger. ``outliers`` is the fraction of angles
    that may have any value. An angle that is more likely an outlier is ignored.
    """
    x, p, gain = np.zeros(ORDER), np.zeros((ORDER, ORDER)), np.empty(ORDER)
    p[0, 0] = math.inf
    seen, total = 0, 0.0
    for k in range(len(angle)):
        _predict(x, p, step, process)
        if math.isnan(angle[k]):
            continue
        if not p[0, 0] <= start[0]:
            seen = 0
            for i in range(ORDER):
                x[i] = angle[k] if i == 0 else 0.0
                for j in range(ORDER):
                    p[i, j] = start[i] if i == j else 0.0
        s, y = p[0, 0] + variance[k], angle[k] - x[0]
        y -= 2.0 * math.pi * round(y / (2.0 * math.pi))
        likelihood = math.log(1.0 - outliers) - 0.5 * (math.log(2.0 * math.pi * s) + y * y / s)
        anywhere = math.log(outliers / (2.0 * math.pi)) if outliers > 0.0 else -math.inf
        seen += 1
        if seen > _SETTLE:
            total += max(likelihood, anywhere)
        if likelihood < anywhere:
            continue
        for i in range(ORDER):
            gain[i] = p[i, 0] / s
            x[i] += gain[i] * y
        for i in range(ORDER):
            for j in range(ORDER):
                p[i, j] -= gain[i] * gain[j] * s
    return total


@compiled
def _predict(x: FloatArray, p: FloatArray, step: FloatArray, process: FloatArray) -> None:
    """Replace x by F x and P by F P Fᵀ + Q for one joint, with the transition F (``step``) and Q (``process``)."""
    for d in range(ORDER):
        for e in range(d + 1, ORDER):
            x[d] += step[e - d] * x[e]
            for r in range(ORDER):
                p[r, d] += step[e - d] * p[r, e]
    for d in range(ORDER):
        for c in range(ORDER):
            for e in range(d + 1, ORDER):
                p[d, c] += step[e - d] * p[e, c]
            p[d, c] += process[d, c]
