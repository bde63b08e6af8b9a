"""Repetitions of sit-to-stand and squat movements, their events, and remarks on unusual ones (thesis ch. 6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.protocols.five_times import Attempt
from mocap_id.protocols.repetitions import NAN, STANDING, SUPPORT_LIMIT, Posture, Repetition, RiseDetails
from mocap_id.verdict import Reason

_STILL = 0.05  # share of the peak speed; in a pause, the speed is lower
_PAUSE = 0.2  # s, shortest pause; at seat-off, trunk and legs may both be slow for an instant
_LEVEL = 0.1  # share of the rise; farther from seat and standing, a pause is within the rise
_MOVING = 0.15  # share of the peak speed; if the speed at its end is higher, the recording may cut off a movement


def find_sit_to_stand_repetitions(
    time: FloatArray, posture: Posture, touching: BoolArray | None, *, chair: bool | None
) -> tuple[Repetition, ...]:
    """Find the repetitions of rising from a chair and sitting down, or of squatting.

    ``time`` (T,) are the sample times, s; ``touching`` (T,) marks the samples with chair contact, None if unknown.
    ``chair`` says whether a chair is used; None, if unknown, counts as True.
    """
    if not posture.moves:
        return ()
    if chair is not False:
        return tuple(_describe_rise(time, posture, touching, up) for up in find_runs(posture.upright))
    squats = []
    for down in find_runs(~posture.upright):
        if down.start == 0 or down.stop == len(time):  # not between two upright phases
            continue
        before, after = _find_neighbours(~posture.upright, down)
        start = _find_rest(time, posture, before, _find_peak_speed(posture.speed, before, down), last=True)
        stand = _find_rest(time, posture, after, _find_peak_speed(posture.speed, down, after))
        why = ["the recording begins during the descent"] if np.isnan(start) else []
        why += ["the recording ends during the rise"] if np.isnan(stand) else []
        squats.append(Repetition(start, NAN, stand, NAN, stand, not why, "; ".join(why)))
    return tuple(squats)


def estimate_event_sd(
    time: FloatArray,
    posture: Posture,
    repetitions: Sequence[Repetition],
    speed_sd: FloatArray,
    above_noise: BoolArray | None,
) -> dict[str, FloatArray]:
    """Return the standard deviations of `start`, `stand`, `seat_on` and `end` of each repetition, s; NaN if unknown.

    The first three follow from the speed: half the difference between the events with the speed raised and lowered by
    its standard deviation ``speed_sd`` (T,), rad/s. An event lies up to one frame before or after the sample that is
    given for it. For `seat_on`, the chair's force is extrapolated from the first sample with a force above the noise
    (``above_noise``, as in :class:`~mocap_id.protocols.chair_contact.Contact`); the standard deviation is the length of
    the extrapolation. A rule without a threshold gives none.
    """
    frame = float(np.median(np.diff(time))) ** 2 / 3  # of an error between 0 and one frame
    slow, fast = (
        find_sit_to_stand_repetitions(
            time, replace(posture, speed=np.maximum(posture.speed + sign * speed_sd, 0.0)), None, chair=None
        )
        for sign in (-1, 1)
    )
    found = {}
    for name in ("start", "stand", "end"):
        early, late = (np.array([getattr(each, name) for each in varied], dtype=np.float64) for varied in (slow, fast))
        found[name] = np.sqrt(((late - early) / 2) ** 2 + frame)
    found["seat_on"] = np.full(len(repetitions), np.nan)
    if above_noise is not None:
        visible = np.append(time[above_noise], np.nan)
        first = np.searchsorted(visible[:-1], [each.seat_on for each in repetitions])
        late = visible[first] - np.array([each.seat_on for each in repetitions])
        found["seat_on"] = np.sqrt(late**2 + frame)
    return found


def _find_neighbours(state: BoolArray, run: slice) -> tuple[slice, slice]:
    """Return the runs of the opposite state before and after a run; empty slices at the ends of the recording."""
    others = find_runs(~state)
    before = [other for other in others if other.stop == run.start]
    after = [other for other in others if other.start == run.stop]
    size = len(state)
    return (before or [slice(0, 0)])[0], (after or [slice(size, size)])[0]


def _describe_rise(time: FloatArray, posture: Posture, touching: BoolArray | None, up: slice) -> Repetition:
    """Return the repetition with the upright phase ``up``: rise, stand and descent."""
    before, after = _find_neighbours(posture.upright, up)
    rises, sits = up.start > 0, up.stop < len(time)  # within the recording
    start = stand = end = seat_off = seat_on = float("nan")
    cut: list[str] = []
    if rises:
        peak = _find_peak_speed(posture.speed, before, up)
        start, stand = _find_rest(time, posture, before, peak, last=True), _find_rest(time, posture, up, peak)
        seat_off = _find_seat_event(time, touching, before, last=True)
        if before.start == 0 and np.isnan(start):
            cut.append("the recording begins during the rise")
        if not sits and np.isnan(stand):
            cut.append("the recording ends during the rise")
    if sits:
        end = _find_rest(time, posture, after, _find_peak_speed(posture.speed, up, after))
        seat_on = _find_seat_event(time, touching, after, last=False)
        if after.stop == len(time) and np.isnan(end):
            cut.append("the recording ends during the descent")
    begins_low, ends_low = _is_below_top(posture, up, 0), _is_below_top(posture, up, -1)
    if not rises and begins_low:
        stand = _find_rest(time, posture, up, _find_peak_speed(posture.speed, up))
    missing = (
        (not rises, f"the recording begins {'during the rise' if begins_low else 'upright'}"),
        (not sits and not cut, f"the recording ends {'during the descent' if ends_low else 'upright'}"),
        (touching is None, "no plate measures when the chair is released"),
        (rises and touching is not None and np.isnan(seat_off), "no chair contact before the rise"),
        (sits and touching is not None and np.isnan(seat_on), "no chair contact after the descent"),
    )
    why = cut + [text for is_missing, text in missing if is_missing]
    return Repetition(start, seat_off, stand, seat_on, end, not why, "; ".join(why))


def _is_below_top(posture: Posture, up: slice, end: int) -> bool:
    """Return whether the first (0) or last (-1) known sample of an upright phase is clearly below its top."""
    known = posture.height[up][np.isfinite(posture.height[up])]
    return bool(len(known) and known.max() - known[end] > _LEVEL)


def _find_peak_speed(speed: FloatArray, *parts: slice) -> float:
    """Return the largest known speed in the given parts of the recording; 0 if no speed is known."""
    joined = np.concatenate([speed[part] for part in parts])
    return float(np.nanmax(joined)) if np.isfinite(joined).any() else 0.0


def _find_rest(time: FloatArray, posture: Posture, part: slice, peak: float, *, last: bool = False) -> float:
    """Return the start of the first pause in a part or, with ``last``, the end of its last pause, s.

    Without a pause, the result is the slowest instant. It is NaN if the recording ends there while the person moves.
    """
    # samples of an upright part near its top, or of a low part near its bottom
    level, height = np.zeros(len(posture.height), dtype=bool), posture.height[part]
    with np.errstate(invalid="ignore"):
        if np.isfinite(height).any():
            high = posture.upright[part.start]
            level[part] = height > np.nanmax(height) - _LEVEL if high else height < np.nanmin(height) + _LEVEL
        still = level & (posture.speed < _STILL * peak)
    pauses = [run for run in find_runs(still) if time[run.stop - 1] - time[run.start] >= _PAUSE]
    if pauses:
        return float(time[pauses[-1].stop - 1] if last else time[pauses[0].start])
    known = np.flatnonzero(level & np.isfinite(posture.speed))
    if not len(known):
        return float("nan")
    slowest = known[np.argmin(posture.speed[known])]
    at_end = part.start == 0 if last else part.stop == len(time)
    cut = at_end and slowest in (known[0], known[-1]) and posture.speed[slowest] > _MOVING * peak
    return float("nan") if cut else float(time[slowest])


def _find_seat_event(time: FloatArray, touching: BoolArray | None, low: slice, *, last: bool) -> float:
    """Return the first contact in a low phase or, with ``last``, seat-off after the last, s; NaN without contact."""
    contact: Sequence[int] = [] if touching is None else np.flatnonzero(touching[low]).tolist()
    if not contact:
        return float("nan")
    index = low.start + contact[-1] + 1 if last else low.start + contact[0]
    return float(time[min(index, len(time) - 1)])


_RISING = 0.25  # share of the rise above which the last sample belongs to a rise


def add_remarks(repetition: Repetition, rise: RiseDetails) -> Repetition:
    """Return the repetition with remarks on its rise in ``why``; it is incomplete if it does not reach standing."""
    remarks = [repetition.why] if repetition.why else []
    if rise.reached < STANDING:
        remarks.append(f"reaches only {100 * rise.reached:.0f} % of the standing height")
    if rise.attempts:
        remarks.append(f"{rise.attempts} failed attempt{'' if rise.attempts == 1 else 's'} before")
    if rise.held > 0:
        remarks.append(f"paused for {rise.held:.1f} s during the rise")
    if rise.support > SUPPORT_LIMIT:
        remarks.append(f"{100 * rise.support:.0f} % of the weight carried by an unknown support")
    complete = repetition.complete and not rise.reached < STANDING
    return replace(repetition, complete=complete, why="; ".join(remarks))


def explain_repetitions(
    repetitions: Sequence[Repetition], rises: Sequence[RiseDetails], attempts: Sequence[Attempt], posture: Posture
) -> tuple[Reason, ...]:
    """Return the reasons for the verdict about the repetitions."""
    reasons = []
    cuts = [part for each in repetitions for part in each.why.split("; ") if part.startswith("the recording ")]
    height = posture.height[np.isfinite(posture.height)]
    if posture.moves and len(height) and not posture.upright[-1] and height[-1] > _RISING:
        cuts.append("the recording ends during a further rise, which is not counted")
    if cuts:
        text = (
            f"{'; '.join(dict.fromkeys(cuts))}: events outside the recording, and quantities of whole repetitions, are "
            "unknown"
        )
        reasons.append(Reason("repetition-cut", text, level="ok"))
    if attempts:
        times = ", ".join(f"{attempt.time_s:.1f} s" for attempt in attempts)
        highest = max(attempt.height for attempt in attempts)
        text = (
            f"an attempt to rise failed {'once' if len(attempts) == 1 else f'{len(attempts)} times'} (at {times}): "
            f"the hips rose up to {100 * max(highest, 0.0):.0f} % of the way to standing and returned to the seat. "
            "Failed attempts are not counted as repetitions"
        )
        reasons.append(Reason("attempt-failed", text, float(len(attempts))))
    numbered = list(enumerate(rises, start=1))
    partial = {str(k): rise.reached for k, rise in numbered if rise.reached < STANDING}
    if partial:
        lowest = min(partial.values())
        text = (
            f"the person does not fully stand in repetition {', '.join(partial)}: the hips reach {100 * lowest:.0f} % "
            "of the height of the other repetitions. It is marked as incomplete and not counted in the five-times "
            "test"
        )
        reasons.append(Reason("rise-partial", text, lowest, STANDING))
    paused = {str(k): rise.held for k, rise in numbered if rise.held > 0}
    if paused:
        longest = max(paused.values())
        text = (
            f"the person pauses between seat and standing in repetition {', '.join(paused)}, for up to {longest:.1f} "
            "s; the times of the repetition include the pause"
        )
        reasons.append(Reason("rise-paused", text, longest))
    supported = {str(k): rise.support for k, rise in numbered if rise.support > SUPPORT_LIMIT}
    if supported:
        most = max(supported.values())
        text = (
            f"in the rise of repetition {', '.join(supported)}, up to {100 * most:.0f} % of the weight is carried "
            "neither by the plates nor, at this height, by a chair: arms on an armrest or rail, or a helping hand. "
            "These samples are used for identification, so parameters and torques are biased; seat-off may be "
            "found late. In these rises, and in the sitting before them, joint torques are unknown (NaN)"
        )
        reasons.append(Reason("support-unexplained", text, most, SUPPORT_LIMIT))
    return tuple(reasons)
