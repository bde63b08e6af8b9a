"""Attempts to rise that fail: the hips leave the seat, or the chair is unloaded, and the person falls back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.lowpass import LowPass, runs
from mocap_id.protocols.posture import Posture
from mocap_id.protocols.repetitions import Repetition

_HIPS = 0.08  # of the rise, up and down again: about 3 cm
_UNLOADED = 0.4  # of what the chair carries at rest
_APART = 1.0  # s: signs that are closer are of one attempt
_SMOOTH = 5.0  # Hz


@dataclass(frozen=True)
class Attempt:
    """A rise that was broken off.

    Parameters
    ----------
    time : float
        When it was highest, s.
    height : float
        Of the rise from seat to standing.
    unloaded : float
        Share of the chair's load at rest that the feet took over; NaN where no plate tells.
    """

    time: float
    height: float
    unloaded: float


def failed_attempts(
    time: FloatArray,
    posture: Posture,
    vertical: FloatArray,
    repetitions: tuple[Repetition, ...],
    *,
    chair: bool | None,
) -> tuple[Attempt, ...]:
    """Attempts in the low phases, in the order of time.

    A rise of the hips by 8 % of the way to standing that ends on the seat is one. So is an unloading of the chair by
    40 % between the repetitions without any rise of the hips; within a repetition that is how the rise begins.

    Parameters
    ----------
    time : (T,) array
        s.
    posture : Posture
    vertical : (T,) array
        Force under the feet over the standing weight; NaN where unknown.
    repetitions : tuple of Repetition
    chair : bool or None
        A chair is used; in squats (False) nothing is an attempt.
    """
    if not posture.moves or chair is False:
        return ()
    unloaded = _unloaded(time, posture, vertical)
    between = _between(time, repetitions)
    instants: list[int] = []
    for low in runs(~posture.upright):
        instants += [low.start + k for k in _peaks(np.nan_to_num(posture.height[low], nan=0.0), _HIPS)]
        signs = np.where(between[low], np.nan_to_num(unloaded[low], nan=0.0), 0.0)
        instants += [low.start + k for k in _peaks(signs, _UNLOADED) if signs[k] >= _UNLOADED]
    found: list[Attempt] = []
    for k in sorted(instants, key=lambda k: -posture.height[k]):
        if all(abs(time[k] - other.time) > _APART for other in found):
            near = slice(*np.searchsorted(time, [time[k] - _APART, time[k] + _APART]))
            known = unloaded[near][np.isfinite(unloaded[near])]
            taken = float(known.max()) if len(known) else float("nan")
            found.append(Attempt(float(time[k]), float(posture.height[k]), taken))
    return tuple(sorted(found, key=lambda attempt: attempt.time))


def _peaks(values: FloatArray, prominence: float) -> list[int]:
    """Peaks that stand so far above the lowest value on either side, up to the next higher peak."""
    lowest = np.maximum(np.minimum.accumulate(values), np.minimum.accumulate(values[::-1])[::-1])
    candidates = np.flatnonzero(values - lowest >= prominence)
    if not candidates.size:
        return []
    top = int(candidates[values[candidates].argmax()])
    return [*_peaks(values[: top + 1], prominence), top, *(top + k for k in _peaks(values[top:], prominence))]


def _between(time: FloatArray, repetitions: tuple[Repetition, ...]) -> BoolArray:
    """Samples (T,) that belong to no repetition, nor to one that the recording cuts off."""
    out = np.ones(len(time), dtype=bool)
    for each in repetitions:
        begin = -np.inf if np.isnan(each.start) else each.start
        finish = np.inf if np.isnan(each.end) else each.end
        out &= (time < begin) | (time > finish)
    return out


def _unloaded(time: FloatArray, posture: Posture, vertical: FloatArray) -> FloatArray:
    """Share of the chair's load at rest that the feet took over, (T,), in the low phases; NaN where unknown."""
    out = np.full(len(time), np.nan)
    rate = (len(time) - 1) / (time[-1] - time[0])
    smooth = LowPass(min(_SMOOTH, rate / 5), rate)(vertical[:, None])[:, 0]
    for low in runs(~posture.upright):
        with np.errstate(invalid="ignore"):
            seated = low.start + np.flatnonzero((posture.height[low] < _HIPS) & np.isfinite(smooth[low]))
        if len(seated):
            rest = float(np.median(smooth[seated]))
            out[low] = (smooth[low] - rest) / max(1.0 - rest, 0.1)
    return out
