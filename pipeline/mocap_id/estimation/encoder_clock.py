"""Sign, zero and clock offset of an encoder relative to the cameras, from the movement that both record.

The joint angle c(t) from the cameras and the angle e(t) on the encoder's clock satisfy ``c(t) = sign * e(t - offset) +
zero``: the encoder's row at t is the state at t + offset on the markers' clock. For both signs, the squared difference
is minimised over the offset, and the sign with the smaller difference is chosen. Both series are smoothed, so their
differences are correlated; the standard deviations account for this (Newey and West).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import minimize_scalar

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.encoder_smoothing import EncoderStates

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
