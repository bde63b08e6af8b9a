"""Detection of failed attempts to rise: the hips leave the seat or the chair is unloaded, and the person falls back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.dynamics.lowpass import LowPass
from mocap_id.protocols.posture import Posture
from mocap_id.protocols.repetitions import Repetition

_HIP_RISE = 0.08  # as a share of the rise to standing: about 3 cm
_UNLOADED = 0.4  # as a share of the chair load at rest
_MERGE_WITHIN = 1.0  # s
_CUTOFF = 5.0  # Hz


@dataclass(frozen=True)
class Attempt:
    """A failed attempt to rise.

    Parameters
    ----------
    time : float
        Time of the greatest height, s.
    height : float
        Greatest height as a share of the rise from seat to standing.
    unloaded : float
        Share of the chair load at rest that the feet took over; NaN if unknown.
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
    """Find failed attempts in the low phases, in order of time.

    An attempt is a rise of the hips by 8 % of the way to standing that ends on the seat, or an unloading of the chair
    by 40 % between repetitions. Unloading within a repetition is the beginning of its rise.

    Parameters
    ----------
    time : (T,) array
        s.
    posture : Posture
    vertical : (T,) array
        Force under the feet divided by the standing weight; NaN where unknown.
    repetitions : tuple of Repetition
    chair : bool or None
        Whether a chair is used; squats (False) have no attempts.
    """
    if not posture.moves or chair is False:
        return ()
    unloaded = _unloaded(time, posture, vertical)
    between = _between(time, repetitions)
    instants: list[int] = []
    for low in find_runs(~posture.upright):
        instants += [low.start + k for k in _peaks(np.nan_to_num(posture.height[low], nan=0.0), _HIP_RISE)]
        signs = np.where(between[low], np.nan_to_num(unloaded[low], nan=0.0), 0.0)
        instants += [low.start + k for k in _peaks(signs, _UNLOADED) if signs[k] >= _UNLOADED]
    found: list[Attempt] = []
    for k in sorted(instants, key=lambda k: -posture.height[k]):
        if all(abs(time[k] - other.time) > _MERGE_WITHIN for other in found):
            near = slice(*np.searchsorted(time, [time[k] - _MERGE_WITHIN, time[k] + _MERGE_WITHIN]))
            known = unloaded[near][np.isfinite(unloaded[near])]
            taken = float(known.max()) if len(known) else float("nan")
            found.append(Attempt(float(time[k]), float(posture.height[k]), taken))
    return tuple(sorted(found, key=lambda attempt: attempt.time))


def _peaks(values: FloatArray, prominence: float) -> list[int]:
    """Return the indices of the peaks with at least this prominence, in order."""
    lowest = np.maximum(np.minimum.accumulate(values), np.minimum.accumulate(values[::-1])[::-1])
    candidates = np.flatnonzero(values - lowest >= prominence)
    if not candidates.size:
        return []
    top = int(candidates[values[candidates].argmax()])
    return [*_peaks(values[: top + 1], prominence), top, *(top + k for k in _peaks(values[top:], prominence))]


def _between(time: FloatArray, repetitions: tuple[Repetition, ...]) -> BoolArray:
    """Return the samples (T,) outside all repetitions, including repetitions cut off by the recording."""
    out = np.ones(len(time), dtype=bool)
    for each in repetitions:
        begin = -np.inf if np.isnan(each.start) else each.start
        finish = np.inf if np.isnan(each.end) else each.end
        out &= (time < begin) | (time > finish)
    return out


def _unloaded(time: FloatArray, posture: Posture, vertical: FloatArray) -> FloatArray:
    """Return the share of the chair load at rest taken over by the feet in low phases, (T,); NaN where unknown."""
    out = np.full(len(time), np.nan)
    rate = (len(time) - 1) / (time[-1] - time[0])
    smooth = LowPass(min(_CUTOFF, rate / 5), rate)(vertical[:, None])[:, 0]
    for low in find_runs(~posture.upright):
        with np.errstate(invalid="ignore"):
            seated = low.start + np.flatnonzero((posture.height[low] < _HIP_RISE) & np.isfinite(smooth[low]))
        if len(seated):
            rest = float(np.median(smooth[seated]))
            out[low] = (smooth[low] - rest) / max(1.0 - rest, 0.1)
    return out
