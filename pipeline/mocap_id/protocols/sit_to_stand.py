"""Repetitions of sit-to-stand and squat movements, with their events (thesis ch. 6)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.protocols.posture import Posture
from mocap_id.protocols.repetitions import Repetition

_STILL = 0.05  # share of the peak speed; slower than this is a pause …
_PAUSE = 0.2  # … if it lasts this long, s; at seat-off, trunk and legs may both be slow for an instant
_LEVEL = 0.1  # share of the rise; farther from seat and standing, a pause is within the rise
_MOVING = 0.15  # share of the peak speed; if faster at its end, the recording may cut off a movement


def sit_to_stand_repetitions(
    time: FloatArray, posture: Posture, touching: BoolArray | None, *, chair: bool | None
) -> tuple[Repetition, ...]:
    """Find the repetitions of rising from a chair and sitting down, or of squatting.

    Parameters
    ----------
    time : (T,) array
        s.
    posture : Posture
    touching : (T,) bool array or None
        Contact with the chair; None if unknown.
    chair : bool or None
        Whether a chair is used; None counts as True.
    """
    if not posture.moves:
        return ()
    if chair is not False:
        return tuple(_rising(time, posture, touching, up) for up in find_runs(posture.upright))
    down = [run for run in find_runs(~posture.upright) if run.start > 0 and run.stop < len(time)]
    return tuple(_squatting(time, posture, run) for run in down)


def _neighbours(state: BoolArray, run: slice) -> tuple[slice, slice]:
    """Return the runs of the opposite state before and after a run; empty at the ends of the recording."""
    others = find_runs(~state)
    before = [other for other in others if other.stop == run.start]
    after = [other for other in others if other.start == run.stop]
    size = len(state)
    return (before or [slice(0, 0)])[0], (after or [slice(size, size)])[0]


def _rising(time: FloatArray, posture: Posture, touching: BoolArray | None, up: slice) -> Repetition:
    """Return the repetition around one upright phase."""
    before, after = _neighbours(posture.upright, up)
    rose, sat = up.start > 0, up.stop < len(time)
    start = stand = end = seat_off = seat_on = float("nan")
    cut: list[str] = []
    if rose:
        peak = _peak(posture.speed, before, up)
        start, stand = _rest(time, posture, before, peak, last=True), _rest(time, posture, up, peak)
        seat_off = _event(time, touching, before, last=True)
        if before.start == 0 and np.isnan(start):
            cut.append("the recording begins during the rise")
        if not sat and np.isnan(stand):
            cut.append("the recording ends during the rise")
    if sat:
        end = _rest(time, posture, after, _peak(posture.speed, up, after))
        seat_on = _event(time, touching, after, last=False)
        if after.stop == len(time) and np.isnan(end):
            cut.append("the recording ends during the descent")
    begun, ended = _below_top(posture, up, 0), _below_top(posture, up, -1)
    if not rose and begun:
        stand = _rest(time, posture, up, _peak(posture.speed, up))
    missing = [
        text
        for absent, text in (
            (not rose, f"the recording begins {'during the rise' if begun else 'upright'}"),
            (not sat and not cut, f"the recording ends {'during the descent' if ended else 'upright'}"),
            (touching is None, "no plate shows when the chair is released"),
            (rose and touching is not None and np.isnan(seat_off), "no chair contact before the rise"),
            (sat and touching is not None and np.isnan(seat_on), "no chair contact after the descent"),
        )
        if absent
    ]
    return Repetition(start, seat_off, stand, seat_on, end, not (cut or missing), "; ".join(cut + missing))


def _below_top(posture: Posture, up: slice, end: int) -> bool:
    """Return whether the first (0) or last (-1) known sample of an upright phase is clearly below its top."""
    known = posture.height[up][np.isfinite(posture.height[up])]
    return bool(len(known) and known.max() - known[end] > _LEVEL)


def _squatting(time: FloatArray, posture: Posture, down: slice) -> Repetition:
    """Return the repetition around one low phase between two upright phases."""
    before, after = _neighbours(~posture.upright, down)
    start = _rest(time, posture, before, _peak(posture.speed, before, down), last=True)
    stand = _rest(time, posture, after, _peak(posture.speed, down, after))
    cut = [
        text
        for instant, text in (
            (start, "the recording begins during the descent"),
            (stand, "the recording ends during the rise"),
        )
        if np.isnan(instant)
    ]
    return Repetition(start, float("nan"), stand, float("nan"), stand, not cut, "; ".join(cut))


def _peak(speed: FloatArray, *parts: slice) -> float:
    joined = np.concatenate([speed[part] for part in parts])
    return float(np.nanmax(joined)) if np.isfinite(joined).any() else 0.0


def _rest(time: FloatArray, posture: Posture, part: slice, peak: float, *, last: bool = False) -> float:
    """Return when the first pause of a part begins, or the last one ends; without a pause, its slowest instant.

    NaN if the part extends to the end of the recording and the person still moves there: the rest is outside.
    """
    level = _at_level(posture, part)
    pauses = _pauses(time, posture.speed, level, peak)
    if pauses:
        return float(time[pauses[-1].stop - 1] if last else time[pauses[0].start])
    known = np.flatnonzero(level & np.isfinite(posture.speed))
    if not len(known):
        return float("nan")
    slowest = known[np.argmin(posture.speed[known])]
    at_end = part.start == 0 if last else part.stop == len(time)
    cut = at_end and slowest in (known[0], known[-1]) and posture.speed[slowest] > _MOVING * peak
    return float("nan") if cut else float(time[slowest])


def _at_level(posture: Posture, part: slice) -> BoolArray:
    """Return the samples (T,) of an upright part near its greatest height, or of a low part near its lowest."""
    level = np.zeros(len(posture.height), dtype=bool)
    height = posture.height[part]
    if np.isfinite(height).any():
        with np.errstate(invalid="ignore"):
            high = posture.upright[part.start]
            near = height > np.nanmax(height) - _LEVEL if high else height < np.nanmin(height) + _LEVEL
        level[part] = near
    return level


def _pauses(time: FloatArray, speed: FloatArray, level: BoolArray, peak: float) -> list[slice]:
    """Return the runs of stillness within the samples of ``level``."""
    with np.errstate(invalid="ignore"):
        still = level & (speed < _STILL * peak)
    return [run for run in find_runs(still) if time[run.stop - 1] - time[run.start] >= _PAUSE]


def _event(time: FloatArray, touching: BoolArray | None, low: slice, *, last: bool) -> float:
    """Return the time of the chair's release (last contact) or touch (first contact) in a low phase, or NaN."""
    found: Sequence[int] = [] if touching is None else np.flatnonzero(touching[low]).tolist()
    if not found:
        return float("nan")
    index = low.start + found[-1] + 1 if last else low.start + found[0]
    return float(time[min(index, len(time) - 1)])
