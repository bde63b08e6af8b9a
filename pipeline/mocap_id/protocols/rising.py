"""Repetitions of rising from a chair and sitting down again, or of squatting, whatever their number (thesis ch. 6)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.lowpass import runs
from mocap_id.protocols.posture import Posture
from mocap_id.protocols.repetitions import Repetition

_STILL = 0.05  # of the peak speed: slower than this is a pause …
_PAUSE = 0.2  # … if it lasts this long, s: at seat-off trunk and legs may both be slow for an instant
_LEVEL = 0.1  # of the rise: farther from the seat, or from standing, a pause is one in mid-rise
_MOVING = 0.15  # of the peak speed: a recording whose end is faster may cut a movement off


def sit_to_stand_repetitions(
    time: FloatArray, posture: Posture, touching: BoolArray | None, *, chair: bool | None
) -> tuple[Repetition, ...]:
    """Repetitions of rising from a chair and sitting down again, or of squatting.

    Parameters
    ----------
    time : (T,) array
        s.
    posture : Posture
    touching : (T,) bool array or None
        Contact with the chair; None where no plate tells.
    chair : bool or None
        A chair is used; None counts as one.
    """
    if not posture.moves:
        return ()
    if chair is not False:
        return tuple(_rising(time, posture, touching, up) for up in runs(posture.upright))
    down = [run for run in runs(~posture.upright) if run.start > 0 and run.stop < len(time)]
    return tuple(_squatting(time, posture, run) for run in down)


def neighbours(state: BoolArray, run: slice) -> tuple[slice, slice]:
    """The stretches of the opposite state on both sides of a run; empty at the recording's ends."""
    others = runs(~state)
    before = [other for other in others if other.stop == run.start]
    after = [other for other in others if other.start == run.stop]
    size = len(state)
    return (before or [slice(0, 0)])[0], (after or [slice(size, size)])[0]


def _rising(time: FloatArray, posture: Posture, touching: BoolArray | None, up: slice) -> Repetition:
    """The repetition around one upright phase."""
    before, after = neighbours(posture.upright, up)
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
            (rose and touching is not None and np.isnan(seat_off), "no contact with the chair before the rise"),
            (sat and touching is not None and np.isnan(seat_on), "no contact with the chair after the descent"),
        )
        if absent
    ]
    return Repetition(start, seat_off, stand, seat_on, end, not (cut or missing), "; ".join(cut + missing))


def _below_top(posture: Posture, up: slice, end: int) -> bool:
    """Whether the first (0) or last (-1) known sample of an upright phase lies clearly below its top."""
    known = posture.height[up][np.isfinite(posture.height[up])]
    return bool(len(known) and known.max() - known[end] > _LEVEL)


def _squatting(time: FloatArray, posture: Posture, down: slice) -> Repetition:
    """The repetition around one low phase between two upright ones."""
    before, after = neighbours(~posture.upright, down)
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
    """When a part's first pause at its own level begins, or the last one ends; without one, its slowest instant there.

    NaN where the part reaches to the recording's end and nothing in it is slow, nor slower than what is before and
    after: the rest lies outside.
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
    """Samples (T,) of a part near its own highest place, of an upright one, or its lowest, of a low one."""
    level = np.zeros(len(posture.height), dtype=bool)
    height = posture.height[part]
    if np.isfinite(height).any():
        with np.errstate(invalid="ignore"):
            high = posture.upright[part.start]
            near = height > np.nanmax(height) - _LEVEL if high else height < np.nanmin(height) + _LEVEL
        level[part] = near
    return level


def _pauses(time: FloatArray, speed: FloatArray, level: BoolArray, peak: float) -> list[slice]:
    """Stretches of stillness among the samples of ``level``, in samples of the trial."""
    with np.errstate(invalid="ignore"):
        still = level & (speed < _STILL * peak)
    return [run for run in runs(still) if time[run.stop - 1] - time[run.start] >= _PAUSE]


def _event(time: FloatArray, touching: BoolArray | None, low: slice, *, last: bool) -> float:
    """Time of the chair's release (last contact) or touch (first contact) in a low phase; NaN without one."""
    found: Sequence[int] = [] if touching is None else np.flatnonzero(touching[low]).tolist()
    if not found:
        return float("nan")
    index = low.start + found[-1] + 1 if last else low.start + found[0]
    return float(time[min(index, len(time) - 1)])
