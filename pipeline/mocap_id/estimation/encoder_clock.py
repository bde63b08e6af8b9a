"""Sign, zero and clock offset of an encoder relative to the cameras, from the movement seen by both.

With the joint angle c(t) by the cameras and e(t) by the encoder's own clock, ``c(t) = sign * e(t - offset) + zero``:
the encoder's row at t is the state at t + offset on the markers' clock. For both signs, the squared difference is
minimised over the offset, and the better sign is taken. Both series are smoothed, so their differences are correlated;
the standard deviations allow for this (Newey and West).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import minimize_scalar

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.estimation.encoder_smoothing import EncoderStates

LEAST_OVERLAP = 0.5
"""Least share of the cameras' frames that the encoder must cover at an offset."""

_COARSE = 5e-3  # s
_FINE = 1e-8  # s
_LAG = 0.5  # s; lag beyond which differences are uncorrelated
_AT_ONCE = 400  # frames used in the coarse search


@dataclass(frozen=True)
class EncoderMatch:
    """Transformation from the encoder's angle to the cameras' angle.

    Parameters
    ----------
    sign : int
        1 if the encoder counts in the same direction as the plane, otherwise -1.
    zero, zero_sd : float
        Angle in the plane at the encoder's zero, and its standard deviation, rad.
    offset, offset_sd : float
        The encoder's row at t is the state at t + offset on the markers' clock; and the standard deviation, s.
    r2 : float
        r² of the transformed encoder angle relative to the cameras' angle.
    rms : float
        rms of their difference, rad.
    other_sense : float
        rms difference with the opposite sign, at its best offset, rad.
    gain : float
        Best factor on the encoder's angle; 1 if both measure the same angle.
    at_edge : bool
        The least difference is at an end of the search range.
    """

    sign: int
    zero: float
    zero_sd: float
    offset: float
    offset_sd: float
    r2: float
    rms: float
    other_sense: float
    gain: float
    at_edge: bool

    def into_plane(self, mean: FloatArray) -> FloatArray:
        """Return states (K, 3) with the plane's sign and zero."""
        moved = self.sign * mean
        moved[:, 0] += self.zero
        return np.asarray(moved)


@dataclass(frozen=True)
class _Curves:
    """Both angles: known frames of the cameras, and the encoder's curve."""

    time: FloatArray
    angle: FloatArray
    curve: CubicHermiteSpline
    start: float
    end: float

    def encoder(self, offset: float, frames: slice = slice(None)) -> tuple[FloatArray, BoolArray]:
        """Return the encoder's angle at the frames for an offset, and the frames inside its record."""
        time = self.time[frames] - offset
        inside: BoolArray = (time >= self.start) & (time <= self.end)
        return np.asarray(self.curve(np.clip(time, self.start, self.end))), inside

    def cost(self, offset: float, sign: int, frames: slice = slice(None)) -> float:
        """Return the mean square difference with the best zero, rad²; infinite with too few common frames."""
        encoder, inside = self.encoder(offset, frames)
        if np.count_nonzero(inside) < LEAST_OVERLAP * len(inside):
            return math.inf
        return float(np.var((self.angle[frames] - sign * encoder)[inside]))


def match_encoder(time: FloatArray, angle: FloatArray, encoder: EncoderStates, limit: float) -> EncoderMatch | None:
    """Find sign, zero and clock offset of an encoder.

    Parameters
    ----------
    time : (F,) array
        Times of the cameras' frames, s.
    angle : (F,) array
        Joint angle by the cameras, unwrapped, rad; NaN where unknown.
    encoder : EncoderStates
        Encoder states at its own times.
    limit : float
        Largest offset tried in either direction, s.

    Returns
    -------
    EncoderMatch or None
        None if at every offset fewer than half of the frames are covered.
    """
    known = np.isfinite(angle)
    curve = CubicHermiteSpline(encoder.time, encoder.mean[:, 0], encoder.mean[:, 1])
    curves = _Curves(time[known], angle[known], curve, float(encoder.time[0]), float(encoder.time[-1]))
    if known.sum() < 2:
        return None
    best = {sign: _best_offset(curves, sign, limit) for sign in (1, -1)}
    if not min(cost for _, cost in best.values()) < math.inf:
        return None
    sign = min(best, key=lambda each: best[each][1])
    offset = best[sign][0]
    edge = abs(offset) > limit - _COARSE / 10
    return _matched(curves, sign, offset, other=math.sqrt(best[-sign][1]), at_edge=edge)


def _best_offset(curves: _Curves, sign: int, limit: float) -> tuple[float, float]:
    frames = slice(None, None, max(1, len(curves.time) // _AT_ONCE))
    grid = np.linspace(-limit, limit, 2 * math.ceil(limit / _COARSE) + 1)
    coarse = [curves.cost(float(offset), sign, frames) for offset in grid]
    at = int(np.argmin(coarse))
    if not math.isfinite(coarse[at]):
        return 0.0, math.inf
    bounds = (grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)])
    found = minimize_scalar(
        lambda offset: min(curves.cost(float(offset), sign), 1e12),
        bounds=bounds,
        method="bounded",
        options={"xatol": _FINE},
    )
    return float(found.x), float(found.fun)


def _matched(curves: _Curves, sign: int, offset: float, *, other: float, at_edge: bool) -> EncoderMatch:
    encoder, inside = curves.encoder(offset)
    angle, encoder, time = curves.angle[inside], encoder[inside], curves.time[inside]
    zero = float(np.mean(angle - sign * encoder))
    rest = angle - sign * encoder - zero
    rms = float(np.std(rest))
    slopes = np.column_stack([-sign * curves.curve(time - offset, 1), np.ones(len(time))])
    sds = _sds(slopes, rest, max(1, round(_LAG / float(np.median(np.diff(time))))))
    spread, moved = float(np.var(angle)), float(np.var(encoder))
    return EncoderMatch(
        sign=sign,
        zero=zero,
        zero_sd=float(sds[1]),
        offset=offset,
        offset_sd=float(sds[0]),
        r2=1.0 - rms**2 / spread if spread > 0 else math.nan,
        rms=rms,
        other_sense=other,
        gain=sign * float(np.cov(angle, encoder, bias=True)[0, 1]) / moved if moved > 0 else math.nan,
        at_edge=at_edge,
    )


def _sds(slopes: FloatArray, rest: FloatArray, lag: int) -> FloatArray:
    """Return least-squares standard deviations (p,) with slopes (N, p), for residuals correlated up to a lag."""
    inverse = np.linalg.pinv(slopes.T @ slopes)
    scores = slopes * rest[:, None]
    meat = scores.T @ scores
    for shift in range(1, min(lag, len(rest) - 1) + 1):
        across = scores[:-shift].T @ scores[shift:]
        meat += (1.0 - shift / (lag + 1)) * (across + across.T)
    return np.asarray(np.sqrt(np.maximum(np.diagonal(inverse @ meat @ inverse), 0.0)))
