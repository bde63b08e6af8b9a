"""Failed attempts to rise: the hips leave the seat or the feet take over load, but the person does not stand up."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.dynamics.lowpass import LowPass
from mocap_id.protocols.posture import Posture
from mocap_id.protocols.repetitions import Repetition
from mocap_id.results import Result

_HIP_RISE = 0.08  # share of the rise to standing: about 3 cm
_UNLOADED = 0.4  # share of the chair's load at rest
_MERGE_WITHIN = 1.0  # s: peaks that are nearer belong to the same attempt
_CUTOFF = 5.0  # Hz, low-pass of the force


class Attempt(Result):
    """A failed attempt to rise."""

    time_s: float  # time of the greatest height
    height: float  # greatest height of the hip as a share of the rise from seat to standing
    unloaded: float | None  # share of the chair's load at rest that the feet took over


def find_failed_attempts(
    time: FloatArray,
    posture: Posture,
    vertical: FloatArray,
    repetitions: tuple[Repetition, ...],
    *,
    chair: bool | None,
) -> tuple[Attempt, ...]:
    """Find the failed attempts to rise, in order of time.

    In a failed attempt, the hips rise by at least 8 % of the rise to standing and return to the seat, or the load on
    the chair decreases by at least 40 % between repetitions. Within a repetition, a decrease is not counted, because it
    is the start of the rise.

    Parameters
    ----------
    time : (T,) array
        Sample times, s.
    vertical : (T,) array
        Vertical force under the feet divided by the standing weight; NaN where unknown.
    chair : bool or None
        Whether a chair is used; None if unknown. Squats (False) have no failed attempts.
    """
    if not posture.moves or chair is False:
        return ()
    unloaded = _measure_unloading(time, posture, vertical)
    between = _find_samples_outside(time, repetitions)
    instants: list[int] = []
    for low in find_runs(~posture.upright):
        instants += [low.start + k for k in _find_peaks(np.nan_to_num(posture.height[low], nan=0.0), _HIP_RISE)]
        shares = np.where(between[low], np.nan_to_num(unloaded[low], nan=0.0), 0.0)
        instants += [low.start + k for k in _find_peaks(shares, _UNLOADED) if shares[k] >= _UNLOADED]
    attempts: list[Attempt] = []
    for k in sorted(instants, key=lambda k: -posture.height[k]):
        if all(abs(time[k] - other.time_s) > _MERGE_WITHIN for other in attempts):
            near = slice(*np.searchsorted(time, [time[k] - _MERGE_WITHIN, time[k] + _MERGE_WITHIN]))
            known = unloaded[near][np.isfinite(unloaded[near])]
            greatest = float(known.max()) if len(known) else float("nan")
            attempts.append(Attempt(time_s=time[k], height=posture.height[k], unloaded=greatest))
    return tuple(sorted(attempts, key=lambda attempt: attempt.time_s))


def _find_peaks(values: FloatArray, prominence: float) -> list[int]:
    """Return the indices of the peaks of a signal that have at least this prominence, in ascending order."""
    lowest = np.maximum(np.minimum.accumulate(values), np.minimum.accumulate(values[::-1])[::-1])
    candidates = np.flatnonzero(values - lowest >= prominence)
    if not candidates.size:
        return []
    top = int(candidates[values[candidates].argmax()])
    after = [top + k for k in _find_peaks(values[top:], prominence)]
    return [*_find_peaks(values[: top + 1], prominence), top, *after]


def _find_samples_outside(time: FloatArray, repetitions: tuple[Repetition, ...]) -> BoolArray:
    """Return True (T,) outside all repetitions; an unknown start or end is replaced by that of the recording."""
    out = np.ones(len(time), dtype=bool)
    for each in repetitions:
        begin = -np.inf if np.isnan(each.start) else each.start
        finish = np.inf if np.isnan(each.end) else each.end
        out &= (time < begin) | (time > finish)
    return out


def _measure_unloading(time: FloatArray, posture: Posture, vertical: FloatArray) -> FloatArray:
    """Return the share (T,) of the chair's load at rest that the feet took over; NaN if unknown and while upright."""
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
