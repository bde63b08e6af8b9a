"""Five-times sit-to-stand test: its times and published times, failed attempts, and load shares of the feet.

A stopwatch starts at the command, so its times also contain the reaction time. The published times are not a diagnosis,
because their sources differ in chair, instruction and stop rule.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.dynamics.preparation import LowPass
from mocap_id.protocols.repetitions import STANDING, Posture, Repetition, RiseDetails
from mocap_id.results import Quantity, Result

_HIP_RISE = 0.08  # share of the rise to standing: about 3 cm
_UNLOADED = 0.4  # share of the chair's load at rest
_MERGE_WITHIN = 1.0  # s: peaks that are nearer belong to the same attempt
_CUTOFF = 5.0  # Hz, low-pass of the force


class Attempt(Result):
    """A failed attempt to rise."""

    time_s: Annotated[float, Quantity("time", "s", decimals=2)]  # of the greatest height
    # greatest height of the hip as a share of the rise from seat to standing
    height: Annotated[float, Quantity("hip height", "% of the rise")]
    # share of the chair's load at rest that the feet took over
    unloaded: Annotated[float | None, Quantity("unloading of the chair", "% of its load")]


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

    ``time`` (T,) are the sample times, s; ``vertical`` (T,) is the vertical force under the feet divided by the
    standing weight, NaN where unknown. ``chair`` says whether a chair is used; None if unknown. Squats (False) have no
    failed attempts.
    """
    if not posture.moves or chair is False:
        return ()
    # share of the chair's load at rest that the feet took over; NaN if unknown and while upright
    unloaded = np.full(len(time), np.nan)
    rate = (len(time) - 1) / (time[-1] - time[0])
    smooth = LowPass(min(_CUTOFF, rate / 5), rate)(vertical[:, None])[:, 0]
    for low in find_runs(~posture.upright):
        with np.errstate(invalid="ignore"):
            seated = low.start + np.flatnonzero((posture.height[low] < _HIP_RISE) & np.isfinite(smooth[low]))
        if len(seated):
            rest = float(np.median(smooth[seated]))
            unloaded[low] = (smooth[low] - rest) / max(1.0 - rest, 0.1)
    between = np.ones(len(time), dtype=bool)  # an unknown start or end of a repetition is that of the recording
    for each in repetitions:
        begin = -np.inf if np.isnan(each.start) else each.start
        finish = np.inf if np.isnan(each.end) else each.end
        between &= (time < begin) | (time > finish)
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


REQUIRED_RISES = 5


class Published(Result):
    """A published time of the five-times sit-to-stand test, for context and not for diagnosis."""

    limit_s: float
    people: str  # group of people in the study
    meaning: str  # meaning of longer times according to the source
    # event at which the stopwatch was stopped; "not said" if the text available to us does not state it
    stop: str
    source: str  # reference to the publication


_BOHANNON = "Bohannon, Percept Mot Skills 2006;103:215-222 (meta-analysis of 13 papers)"
_WORSE = "worse than average for the age"
_RECURRENT = "predicted recurrent falls with sensitivity 55 % and specificity 65 %"
_FALLERS = "distinguished people who fall from others"
_BUATOIS = "Buatois et al., J Am Geriatr Soc 2008;56:1575-1577"
_GURALNIK = "Guralnik et al., J Gerontol A 2000;55:M221-M231"
_DUNCAN = "Duncan et al., Arch Phys Med Rehabil 2011;92:1431"

PUBLISHED = [
    Published(limit_s=limit, people=people, meaning=meaning, stop=stop, source=source)
    for limit, people, meaning, stop, source in (
        (11.4, "60 to 69 years", _WORSE, "not said", _BOHANNON),
        (12.6, "70 to 79 years", _WORSE, "not said", _BOHANNON),
        (14.8, "80 to 89 years", _WORSE, "not said", _BOHANNON),
        (15.0, "2735 people of 65 years and older", _RECURRENT, "not said", _BUATOIS),
        (13.6, "older people", "associated with increased disability and morbidity", "fifth stand", _GURALNIK),
        (16.0, "80 people with Parkinson's disease", _FALLERS, "not said", _DUNCAN),
    )
]


_TO_FIFTH = "time from the start of the first rise to the fifth"


class FiveTimes(Result):
    """Times of the five-times sit-to-stand test by both common stop rules, from the start of the first rise.

    ``…_sd_s`` is the standard deviation of a time, from those of its two events.
    """

    repetitions: Annotated[int | None, Quantity("rises that reach standing")] = None
    to_fifth_stand_s: Annotated[
        float | None,
        Quantity("first rise to fifth stand", "s", "to_fifth_stand_sd_s", "five_times", f"{_TO_FIFTH} stand"),
    ] = None
    to_fifth_seat_contact_s: Annotated[
        float | None,
        Quantity(
            "first rise to fifth seat contact",
            "s",
            "to_fifth_seat_contact_sd_s",
            "five_times_seated",
            f"{_TO_FIFTH} seat contact",
        ),
    ] = None
    to_fifth_seated_s: Annotated[float | None, Quantity("first rise to seated rest", "s", "to_fifth_seated_sd_s")] = (
        None
    )
    to_fifth_stand_sd_s: float | None = None
    to_fifth_seat_contact_sd_s: float | None = None
    to_fifth_seated_sd_s: float | None = None
    # mean and standard deviation over the cycles
    mean_cycle_s: Annotated[
        float | None,
        Quantity("cycle, stand to stand", "s", "cycle_sd_s", "cycle", "mean time from stand to stand", column_sd=False),
    ] = None
    cycle_sd_s: float | None = None
    failed_attempts: Annotated[
        int | None,
        Quantity(
            "failed attempts within this time",
            column="failed_attempts",
            meaning="number of failed rises within this time",
        ),
    ] = None
    published: list[Published] = Field([])
    why: str | None = None  # why a time is unknown; None if all times are known


def compute_five_times(
    repetitions: tuple[Repetition, ...],
    rises: tuple[RiseDetails, ...],
    *,
    chair: bool | None,
    event_sd: Mapping[str, FloatArray] | None = None,
) -> FiveTimes:
    """Return the times of the five-times-sit-to-stand test.

    Rises that do not reach standing, according to ``rises``, are not counted. Squats (``chair`` is False) have no
    times. ``chair`` is None if it is unknown whether a chair is used. ``event_sd`` is the result of
    :func:`mocap_id.protocols.sit_to_stand.estimate_event_sd`; without it, the standard deviations are unknown.
    """
    if chair is False:
        return FiveTimes(
            repetitions=0,
            failed_attempts=0,
            published=PUBLISHED,
            why="no chair is used, so the rises are squats and not sit-to-stands",
        )
    counted = [
        k
        for k, (each, rise) in enumerate(zip(repetitions, rises, strict=True))
        if (not np.isnan(each.stand) or "stand" in each.unmeasured) and not rise.reached < STANDING
    ]
    cycles = np.diff([repetitions[k].stand for k in counted])
    cycles = cycles[np.isfinite(cycles)]
    values: dict[str, Any] = {
        "repetitions": len(counted),
        "mean_cycle_s": float(cycles.mean()) if len(cycles) else None,
        "cycle_sd_s": float(cycles.std(ddof=1)) if len(cycles) > 1 else None,
        "failed_attempts": 0,
        "published": PUBLISHED,
    }
    if len(counted) < REQUIRED_RISES:
        why = f"only {len(counted)} of {REQUIRED_RISES} rises in the recording reach standing"
        return FiveTimes(**values, why=why)
    k_first, k_fifth = counted[0], counted[REQUIRED_RISES - 1]
    first, fifth = repetitions[k_first], repetitions[k_fifth]
    for name, event in (("stand", "stand"), ("seat_contact", "seat_on"), ("seated", "end")):
        values[f"to_fifth_{name}_s"] = getattr(fifth, event) - first.start
        if event_sd is not None:
            # noise and frames shift the start and the end apart alike, so their standard deviations add
            values[f"to_fifth_{name}_sd_s"] = float(event_sd["start"][k_first] + event_sd[event][k_fifth])
    values["failed_attempts"] = sum(rises[k].attempts for k in range(k_first + 1, k_fifth + 1))
    unknown: str | None = None
    if np.isnan(first.start):
        unknown = f"the start of the first rise is unknown: {first.why or 'its angles are unknown'}"
    elif np.isnan([fifth.seat_on, fifth.end]).any() or "stand" in fifth.unmeasured:
        unknown = f"the end of the fifth repetition is unknown: {fifth.why or 'its angles are unknown'}"
    return FiveTimes(**values, why=unknown)


LOAD_PHASES = ("seated", "rising", "standing")
_APART_M = 0.05  # if the centres of pressure are closer, the plates are not side by side


class Spread(Result):
    """Mean and standard deviation of a quantity over the repetitions."""

    mean: float | None = None
    sd: float | None = None


class LoadShare(Result):
    """Share of the left foot in the load of both feet, by phase; unknown unless each foot has its own plate."""

    left_plate: int | None = None  # numbers of the plates, from 1
    right_plate: int | None = None
    left: dict[str, Spread] = Field({phase: Spread() for phase in LOAD_PHASES})
    why: str | None = None  # why the shares are unknown; None if they are known


def find_foot_plates(across: Sequence[tuple[int, float]], forwards: int) -> tuple[int, int] | str:
    """Return the numbers of the plates under left and right foot, or a text that says why they are unknown.

    ``across`` has the number of every plate under the feet, and the z coordinate of its load in the plane's axes, m.
    ``forwards`` is 1 if the person faces x in the plane's axes, -1 if the person faces -x and z points to the left.
    """
    if len(across) != 2:
        return f"left and right need one plate under each foot, but the feet are on {len(across)} plates"
    (one, z_one), (other, z_other) = across
    if not abs(z_one - z_other) > _APART_M:  # also where one is unknown
        return f"plates {one} and {other} are not loaded side by side, so they do not carry one foot each"
    return (one, other) if (z_one > z_other) == (forwards < 0) else (other, one)


def compute_load_share(
    time: FloatArray, posture: Posture, left: FloatArray, right: FloatArray, repetitions: tuple[Repetition, ...]
) -> dict[str, FloatArray]:
    """Return the mean share of the left foot in the load, by phase in :data:`LOAD_PHASES`, (R,) for the R repetitions.

    ``time`` (T,) are the sample times, s; ``left`` and ``right`` (T,) are the vertical forces under each foot, N; NaN
    where unknown.
    """
    out = {phase: np.full(len(repetitions), np.nan) for phase in LOAD_PHASES}
    before = -np.inf
    for k, each in enumerate(repetitions):
        after = repetitions[k + 1].start if k + 1 < len(repetitions) else np.inf
        seated_until = each.start if np.isnan(each.seat_off) else each.seat_off
        standing_until = each.end if each.end > each.stand else np.inf if np.isnan(after) else after
        with np.errstate(invalid="ignore"):
            parts: dict[str, BoolArray] = {
                "seated": (time > before) & (time < seated_until) & (posture.height < 1.0 - STANDING),
                "rising": (time >= each.start) & (time <= each.stand),
                "standing": (time > each.stand) & (time < standing_until) & (posture.height > STANDING),
            }
        for phase, part in parts.items():
            known = part & np.isfinite(left) & np.isfinite(right)
            total = float(left[known].sum() + right[known].sum())
            out[phase][k] = left[known].sum() / total if known.any() and total > 0 else np.nan
        before = each.seat_on if not np.isnan(each.seat_on) else each.end
    return out
