"""States of an encoder, and its sign, zero and clock offset relative to the cameras, from the common movement.

The joint angle c(t) from the cameras and the angle e(t) on the encoder's clock satisfy ``c(t) = sign * e(t - offset) +
zero``: the encoder's row at t is the state at t + offset on the markers' clock. For both signs, the squared difference
is minimised over the offset, and the sign with the smaller difference is chosen. Both series are smoothed, so their
differences are correlated; the standard deviations account for this (Newey and West).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import minimize, minimize_scalar

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.compilation import compiled

_LEAST_OVERLAP = 0.5  # fraction of the cameras' frames that the encoder must cover at an offset
_COARSE, _FINE = 5e-3, 1e-8  # s, steps of the offset in the first and in the second search
_LAG = 0.5  # s; differences that are farther apart in time are uncorrelated
_COARSE_FRAMES = 400  # used in the first search


@dataclass(frozen=True)
class EncoderMatch:
    """Transformation from the encoder's angle to the cameras' angle, and how well it fits."""

    sign: int  # 1 if the encoder's angle increases with the angle in the plane, otherwise -1
    zero: float  # angle in the plane at the encoder's zero, rad
    zero_sd: float  # standard deviation, rad
    offset: float  # the encoder's row at t is the state at t + offset on the markers' clock, s
    offset_sd: float  # standard deviation, s
    r2: float  # r² of the transformed encoder angle relative to the cameras' angle
    rms: float  # rms difference of the two angles, rad
    opposite_rms: float  # rms difference with the opposite sign, at the best offset for it, rad
    gain: float  # factor on the encoder's angle that fits best; 1 if both measure the same angle
    at_edge: bool  # the smallest difference is at an end of the search range

    def express_in_plane(self, mean: FloatArray) -> FloatArray:
        """Return states (K, 3) of the encoder with the sign and zero of the angle in the plane."""
        moved = self.sign * mean
        moved[:, 0] += self.zero
        return np.asarray(moved)


def match_encoder(time: FloatArray, angle: FloatArray, encoder: EncoderStates, limit: float) -> EncoderMatch | None:
    """Estimate sign, zero and clock offset of an encoder; None if its record covers too few frames at every offset.

    ``angle`` (F,) is the joint angle from the cameras at ``time`` (F,), s: unwrapped, rad, NaN where missing. ``limit``
    is the largest offset tried in either direction, s.
    """
    known = np.isfinite(angle)
    curve = CubicHermiteSpline(encoder.time, encoder.mean[:, 0], encoder.mean[:, 1])
    time, angle, start, end = time[known], angle[known], float(encoder.time[0]), float(encoder.time[-1])
    if known.sum() < 2:
        return None

    def encoder_at(offset: float, frames: slice = slice(None)) -> tuple[FloatArray, BoolArray]:
        """Return the encoder's angle in some frames for an offset, s, and whether each frame is within its record."""
        stamps = time[frames] - offset
        inside: BoolArray = (stamps >= start) & (stamps <= end)
        return np.asarray(curve(np.clip(stamps, start, end))), inside

    def cost(offset: float, sign: int, frames: slice = slice(None)) -> float:
        """Return the mean square difference of both angles, with fitted zero, rad²; infinite with too few frames."""
        own, inside = encoder_at(offset, frames)
        if np.count_nonzero(inside) < _LEAST_OVERLAP * len(inside):
            return math.inf
        return float(np.var((angle[frames] - sign * own)[inside]))

    # the offset with the least mean square difference for both signs: on a grid, then between its neighbours
    some = slice(None, None, max(1, len(time) // _COARSE_FRAMES))
    grid = np.linspace(-limit, limit, 2 * math.ceil(limit / _COARSE) + 1)
    offsets, costs = dict.fromkeys((1, -1), 0.0), dict.fromkeys((1, -1), math.inf)
    for sign in offsets:
        coarse = [cost(float(offset), sign, some) for offset in grid]
        at = int(np.argmin(coarse))
        if math.isfinite(coarse[at]):
            best = minimize_scalar(
                lambda offset, sign=sign: min(cost(float(offset), sign), 1e12),
                bounds=(grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]),
                method="bounded",
                options={"xatol": _FINE},
            )
            offsets[sign], costs[sign] = float(best.x), float(best.fun)
    if not min(costs.values()) < math.inf:
        return None
    sign = min(costs, key=lambda each: costs[each])
    offset = offsets[sign]

    # the transformation at this offset
    measured, inside = encoder_at(offset)
    angle, measured, time = angle[inside], measured[inside], time[inside]
    zero = float(np.mean(angle - sign * measured))
    residual = angle - sign * measured - zero
    rms = float(np.std(residual))
    slopes = np.column_stack([-sign * curve(time - offset, 1), np.ones(len(time))])
    # standard deviations, for residuals correlated over ``lag`` samples
    lag = max(1, round(_LAG / float(np.median(np.diff(time)))))
    inverse = np.linalg.pinv(slopes.T @ slopes)
    scores = slopes * residual[:, None]
    total = scores.T @ scores
    for shift in range(1, min(lag, len(residual) - 1) + 1):
        across = scores[:-shift].T @ scores[shift:]
        total += (1.0 - shift / (lag + 1)) * (across + across.T)
    sds = np.sqrt(np.maximum(np.diagonal(inverse @ total @ inverse), 0.0))
    variance, encoder_variance = float(np.var(angle)), float(np.var(measured))
    covariance = sign * float(np.cov(angle, measured, bias=True)[0, 1])
    return EncoderMatch(
        sign=sign,
        zero=zero,
        zero_sd=float(sds[1]),
        offset=offset,
        offset_sd=float(sds[0]),
        r2=1.0 - rms**2 / variance if variance > 0 else math.nan,
        rms=rms,
        opposite_rms=math.sqrt(costs[-sign]),
        gain=covariance / encoder_variance if encoder_variance > 0 else math.nan,
        at_edge=abs(offset) > limit - _COARSE / 10,
    )


START_SD = (1.0, 30.0, 1e3)
"""Standard deviations before the first sample, relative to its position: rad, rad/s, rad/s^2.

They are no larger than needed, because with larger values the first update would subtract nearly equal numbers.
"""

_SIZE = 3  # of the state: angle, velocity, acceleration
_POSITION_SD_FLOOR, _VELOCITY_SD_FLOOR = 1e-7, 1e-6  # rad, rad/s; rounded or simulated records have less noise
_ENOUGH = 6000  # samples for the likelihood; more would hardly improve the noise
_SETTLE = 5  # samples that determine the unknown start; they are not counted in the likelihood
_DENSITY_BOUNDS = (1e-6, 1e12)


@dataclass(frozen=True)
class EncoderNoise:
    """Measurement noise and process noise of an encoder."""

    position_sd: float  # standard deviation of a sample, rad
    velocity_sd: float  # standard deviation of a sample, rad/s
    density: float  # spectral density of the jerk, rad^2/s^5


@dataclass(frozen=True)
class EncoderStates:
    """States of the joint at K times, with the sign, zero and clock of the encoder."""

    time: FloatArray  # (K,) on the encoder's clock, s
    mean: FloatArray  # (K, 3) angle, velocity and acceleration, rad, rad/s, rad/s^2
    sd: FloatArray  # (K, 3) their standard deviations
    log_likelihood: float  # of the innovations at the samples


def smooth_encoder(
    time: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    noise: EncoderNoise,
    *,
    at: FloatArray | None = None,
) -> EncoderStates:
    """Return the smoothed states at the times of the samples, or at the increasing times ``at`` (N,), s, if given.

    ``position`` and ``velocity`` (K,) are the measured angle, rad, and angular velocity, rad/s, at the increasing times
    ``time`` (K,), s.
    """
    times = np.concatenate([time, time[:0] if at is None else at])
    order = np.argsort(times, kind="stable")
    measured, times = order < len(time), times[order]
    values = np.zeros((len(times), 2))
    values[measured] = np.column_stack([position - position[0], velocity])
    variance = np.array([noise.position_sd, noise.velocity_sd]) ** 2
    ahead, ahead_p, mean, covariance, likelihood = _filter(
        times, measured, values, variance, noise.density, np.square(START_SD)
    )
    # smoother
    dt = np.diff(times)
    transition = np.broadcast_to(np.eye(_SIZE), (len(dt), _SIZE, _SIZE)).copy()
    transition[:, 0, 1] = transition[:, 1, 2] = dt
    transition[:, 0, 2] = 0.5 * dt**2
    gain = np.swapaxes(np.linalg.solve(ahead_p[1:], transition @ covariance[:-1]), 1, 2)
    # P + G (P' - A) G' = (P - G A G') + G P' G'; only the last term needs the next frame
    alone = covariance[:-1] - gain @ ahead_p[1:] @ np.swapaxes(gain, 1, 2)
    for k in range(len(dt) - 1, -1, -1):
        mean[k] += gain[k] @ (mean[k + 1] - ahead[k + 1])
        covariance[k] = alone[k] + gain[k] @ covariance[k + 1] @ gain[k].T
    sd = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    mean[:, 0] += position[0]
    kept = measured if at is None else ~measured
    return EncoderStates(times[kept], mean[kept], sd[kept], float(likelihood))


def estimate_encoder_noise(
    time: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    *,
    position_sd: float | None = None,
    velocity_sd: float | None = None,
) -> EncoderNoise:
    """Return the noise with the maximum likelihood of the innovations.

    ``time``, ``position`` and ``velocity`` (K,) are as for :func:`smooth_encoder`. ``position_sd``, rad, and
    ``velocity_sd``, rad/s, are estimated if None. Of a long record, only the part with the most movement is used.
    """
    if len(velocity) > _ENOUGH:  # the successive samples with the most movement
        travelled = np.concatenate([[0.0], np.cumsum(np.abs(velocity))])
        begin = int(np.argmax(travelled[_ENOUGH:] - travelled[:-_ENOUGH]))
        part = slice(begin, begin + _ENOUGH)
        time, position, velocity = time[part], position[part], velocity[part]
    given = np.array([position_sd or math.nan, velocity_sd or math.nan, math.nan])
    floor = np.array([_POSITION_SD_FLOOR, _VELOCITY_SD_FLOOR, _DENSITY_BOUNDS[0]])
    ceiling = np.array([10.0, 100.0, _DENSITY_BOUNDS[1]])
    # start values, from third differences and from the jerk of the smoothed velocity
    step = float(np.median(np.diff(time)))
    sds = [float(np.std(np.diff(each, 3))) / math.sqrt(20.0) for each in (position, velocity)]
    wide = max(1, round(0.05 / step))
    smooth = np.convolve(velocity, np.full(wide, 1.0 / wide), "valid")[::wide]
    jerk = float(np.std(np.diff(smooth, 2))) / (wide * step) ** 2 if len(smooth) > 2 else 1.0
    start = np.clip(np.array([*sds, max(jerk, 1e-2) ** 2 * 0.1]), 2 * floor, 0.5 * ceiling)
    open_ = np.isnan(given)
    measured, values = np.ones(len(time), dtype=np.bool_), np.column_stack([position - position[0], velocity])

    def noise(logs: FloatArray) -> FloatArray:
        full = given.copy()
        full[open_] = np.clip(np.exp(logs), floor[open_], ceiling[open_])
        return full

    def cost(logs: FloatArray) -> float:
        sizes = noise(logs)
        return -float(_filter(time, measured, values, sizes[:2] ** 2, float(sizes[2]), np.square(START_SD))[-1])

    first = np.log(start[open_])
    simplex = np.vstack([first, first + 1.5 * np.eye(len(first))])
    options: Any = {"initial_simplex": simplex, "xatol": 0.005, "fatol": 0.01, "maxfev": 400}
    found = noise(minimize(cost, first, method="Nelder-Mead", options=options).x)
    return EncoderNoise(float(found[0]), float(found[1]), float(found[2]))


@compiled
def _filter(  # noqa: PLR0917
    time: FloatArray, measured: BoolArray, values: FloatArray, variance: FloatArray, density: float, start: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """Run the Kalman filter; return predicted states and covariances, updated states and covariances, log-likelihood.

    States are (K, 3), covariances (K, 3, 3). ``values`` (K, 2) are position and velocity where ``measured`` (K,),
    ``variance`` (2,) is their noise, and ``start`` (3,) are the variances of the first state.
    """
    count = len(time)
    ahead, ahead_p = np.empty((count, _SIZE)), np.empty((count, _SIZE, _SIZE))
    found, found_p = np.empty((count, _SIZE)), np.empty((count, _SIZE, _SIZE))
    x, p, gain = np.zeros(_SIZE), np.zeros((_SIZE, _SIZE)), np.empty(_SIZE)
    for i in range(_SIZE):
        p[i, i] = start[i]
    seen, total = 0, 0.0
    for k in range(count):
        if k > 0:
            dt = time[k] - time[k - 1]
            x[0] += dt * x[1] + 0.5 * dt * dt * x[2]
            x[1] += dt * x[2]
            for c in range(_SIZE):  # F P
                p[0, c] += dt * p[1, c] + 0.5 * dt * dt * p[2, c]
                p[1, c] += dt * p[2, c]
            for r in range(_SIZE):  # (F P) F'
                p[r, 0] += dt * p[r, 1] + 0.5 * dt * dt * p[r, 2]
                p[r, 1] += dt * p[r, 2]
            p[0, 0] += density * dt**5 / 20.0
            p[0, 1] += density * dt**4 / 8.0
            p[0, 2] += density * dt**3 / 6.0
            p[1, 1] += density * dt**3 / 3.0
            p[1, 2] += density * dt**2 / 2.0
            p[2, 2] += density * dt
            p[1, 0], p[2, 0], p[2, 1] = p[0, 1], p[0, 2], p[1, 2]
        ahead[k], ahead_p[k] = x, p
        if measured[k]:
            seen += 1
            for d in range(2):
                s, y = p[d, d] + variance[d], values[k, d] - x[d]
                if seen > _SETTLE:
                    total -= 0.5 * (math.log(2.0 * math.pi * s) + y * y / s)
                for i in range(_SIZE):
                    gain[i] = p[i, d] / s
                for i in range(_SIZE):
                    x[i] += gain[i] * y
                    for j in range(_SIZE):
                        p[i, j] -= gain[i] * gain[j] * s
        found[k], found_p[k] = x, p
    return ahead, ahead_p, found, found_p, total
