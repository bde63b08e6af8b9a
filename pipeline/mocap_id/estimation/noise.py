"""Noise by maximum likelihood of the innovations, on the linear problem that the angles of single frames make.

To first order the likelihood of the markers splits in two. What the chain cannot follow within a frame tells the
marker noise alone; the angles that the frames give by themselves, with the covariance that the marker noise gives
them, are linear measurements of the process and tell the density of its noise. The second part is taken joint by
joint, from the marginal variance of each angle, which costs a scalar filter of four states for every trial value.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from mocap_id.arrays import BoolArray, FloatArray, chunks
from mocap_id.estimation.compiling import compiled
from mocap_id.estimation.inverse import FrameAngles
from mocap_id.estimation.problem import Anchors, start_sd
from mocap_id.estimation.process import noise_shape, transition

SIGMA_V_BOUNDS = (1.0, 1e6)
"""Where the snap's standard deviation over one frame is sought, rad/s^4."""

_FREEDOM_LEVER = 1e-4  # m^2: an angle takes up freedom of the residuals where its markers have a lever above 1 cm
OUTLIER_SHARE = 1e-3
"""Share of the angles of single frames that may be anything; what jumps counts as such, not as process noise."""

_SETTLE = 10  # innovations that the unknown start takes up


@dataclass(frozen=True)
class Noise:
    """Noise of the measurement and of the process.

    Parameters
    ----------
    marker_sd : float
        Standard deviation of a marker's coordinate, m: camera noise and soft tissue together.
    sigma_v : (n,) array
        Standard deviation of each joint's snap held over one frame, rad/s^4; its spectral density is sigma_v^2 dt.
    """

    marker_sd: float
    sigma_v: FloatArray


def marker_noise(frames: FrameAngles, floor: float) -> float:
    """Marker noise (m) from the residuals of the frame-by-frame fit, unbiased by the angles it took up; ≥ ``floor``.

    The floor keeps filtered or synthetic recordings, which hold no noise, from being trusted without limit.
    """
    sound: BoolArray = np.all(frames.reliable, axis=1)
    taken = np.concatenate([_taken_up(frames.information[s]) for s in chunks(len(sound))])
    freedom = 2.0 * np.count_nonzero(frames.used[sound]) - float(np.sum(taken[sound]))
    return max(floor, math.sqrt(frames.squares / freedom)) if freedom >= 1.0 else floor


def _taken_up(information: FloatArray) -> FloatArray:
    """Freedom (f,) of the residuals that the angles of each frame take up, from Jᵀ J (f, n, n)."""
    n = information.shape[1]
    kept = np.linalg.inv(np.eye(n) + information / _FREEDOM_LEVER)
    return np.asarray(n - np.trace(kept, axis1=1, axis2=2))


def process_noise(anchors: Anchors, dt: float) -> FloatArray:
    """Standard deviation of each joint's snap over one frame (n,), rad/s^4, within :data:`SIGMA_V_BOUNDS`.

    Where too few angles are observed to tell, it is the upper bound: states then rest on their own frames alone.

    Parameters
    ----------
    anchors : Anchors
        Angles of every frame and their covariance.
    dt : float
        Time step, s.
    """
    step, shape, start = transition(dt)[0], noise_shape(dt), start_sd(dt) ** 2
    low, high = np.log(SIGMA_V_BOUNDS)
    found = np.empty(anchors.angles.shape[1])
    for j in range(len(found)):
        angle = np.where(anchors.observed[:, j], anchors.angles[:, j], np.nan)
        variance = np.ascontiguousarray(anchors.covariance[:, j, j])

        def cost(log_sigma: float, angle: FloatArray = angle, variance: FloatArray = variance) -> float:
            process = math.exp(2.0 * log_sigma) * dt * shape
            return -log_likelihood(angle, variance, step, process, start, OUTLIER_SHARE)

        best = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 0.01})
        found[j] = math.exp(best.x)
    return found


@compiled
def log_likelihood(  # noqa: PLR0917
    angle: FloatArray, variance: FloatArray, step: FloatArray, process: FloatArray, start: FloatArray, outliers: float
) -> float:
    """Log-likelihood of the innovations of one angle under eq. 3.17, outliers apart.

    Parameters
    ----------
    angle, variance : (F,) array
        Measured angle, rad, NaN where unobserved, and the variance of its noise, rad^2.
    step : (4,) array
        dt^k / k!.
    process : (4, 4) array
        Process noise of a step.
    start : (4,) array
        Variances of the state when nothing is known: at the start, and after a gap that ends beyond them.
    outliers : float
        Share of angles that may lie anywhere on the circle. One that is likelier to be such is not followed.
    """
    x, p, gain = np.zeros(4), np.zeros((4, 4)), np.empty(4)
    p[0, 0] = math.inf
    seen, total = 0, 0.0
    for k in range(len(angle)):
        _predict(x, p, step, process)
        if math.isnan(angle[k]):
            continue
        if not p[0, 0] <= start[0]:
            seen = 0
            for i in range(len(step)):
                x[i] = angle[k] if i == 0 else 0.0
                for j in range(len(step)):
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
        for i in range(len(step)):
            gain[i] = p[i, 0] / s
            x[i] += gain[i] * y
        for i in range(len(step)):
            for j in range(len(step)):
                p[i, j] -= gain[i] * gain[j] * s
    return total


@compiled
def _predict(x: FloatArray, p: FloatArray, step: FloatArray, process: FloatArray) -> None:
    """F x and F P Fᵀ + Q of one joint, in their place."""
    size = len(step)
    for d in range(size):
        for e in range(d + 1, size):
            x[d] += step[e - d] * x[e]
            for r in range(size):
                p[r, d] += step[e - d] * p[r, e]
    for d in range(size):
        for c in range(size):
            for e in range(d + 1, size):
                p[d, c] += step[e - d] * p[e, c]
            p[d, c] += process[d, c]
