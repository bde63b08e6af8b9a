"""Times of the five-times-sit-to-stand test by the common stop rules, and published times for comparison.

A stopwatch starts at the command, so its times also contain the reaction time. The published times are not a diagnosis,
because their sources differ in chair, instruction and stop rule.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.protocols.posture import STANDING
from mocap_id.protocols.repetitions import Repetition, RiseDetails

REQUIRED_RISES = 5


@dataclass(frozen=True)
class FiveTimes:
    """Times of the five-times-sit-to-stand test, s; None if unknown."""

    repetitions: int  # number of rises that reach standing
    # to_fifth_stand, to_fifth_seat_contact, to_fifth_seated: time from the start of the first rise to the fifth
    # stand, to the next seat contact, and to the next seated rest
    to_fifth_stand: float | None = None
    to_fifth_seat_contact: float | None = None
    to_fifth_seated: float | None = None
    # to_fifth_stand_sd, to_fifth_seat_contact_sd, to_fifth_seated_sd: standard deviation of these times
    to_fifth_stand_sd: float | None = None
    to_fifth_seat_contact_sd: float | None = None
    to_fifth_seated_sd: float | None = None
    # mean_cycle, cycle_sd: mean and standard deviation of the time from one stand to the next
    mean_cycle: float | None = None
    cycle_sd: float | None = None
    attempts: int = 0  # number of failed attempts between the first rise and the fifth stand
    why: str | None = None  # reason why a time is unknown; None if all times are known


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
        return FiveTimes(0, why="no chair is used, so the rises are squats and not sit-to-stands")
    counted = [
        k
        for k, (each, rise) in enumerate(zip(repetitions, rises, strict=True))
        if (not np.isnan(each.stand) or "stand" in each.unmeasured) and not rise.reached < STANDING
    ]
    stands = np.array([repetitions[k].stand for k in counted])
    cycles = np.diff(stands)
    cycles = cycles[np.isfinite(cycles)]
    cycle = float(cycles.mean()) if len(cycles) else None
    cycle_sd = float(cycles.std(ddof=1)) if len(cycles) > 1 else None
    if len(counted) < REQUIRED_RISES:
        why = f"only {len(counted)} of {REQUIRED_RISES} rises in the recording reach standing"
        return FiveTimes(len(counted), mean_cycle=cycle, cycle_sd=cycle_sd, why=why)
    first, fifth = counted[0], counted[REQUIRED_RISES - 1]
    start, last = repetitions[first].start, repetitions[fifth]
    events = (last.stand, last.seat_on, last.end)
    stand, contact, seated = (None if np.isnan(event - start) else float(event - start) for event in events)
    sds: dict[str, float | None] = dict.fromkeys(("stand", "seat_on", "end"))
    if event_sd is not None:
        for name in sds:
            # noise and frames shift the start and the end apart alike, so their standard deviations add
            spread = float(event_sd["start"][first] + event_sd[name][fifth])
            sds[name] = None if np.isnan(spread) else spread
    return FiveTimes(
        len(counted),
        stand,
        contact,
        seated,
        sds["stand"],
        sds["seat_on"],
        sds["end"],
        mean_cycle=cycle,
        cycle_sd=cycle_sd,
        attempts=sum(rises[k].attempts for k in range(first + 1, fifth + 1)),
        why=_explain_unknown_time(repetitions[first], last),
    )


def _explain_unknown_time(first: Repetition, fifth: Repetition) -> str | None:
    if np.isnan(first.start):
        return f"the start of the first rise is unknown: {first.why or 'its angles are unknown'}"
    if np.isnan([fifth.seat_on, fifth.end]).any() or "stand" in fifth.unmeasured:
        return f"the end of the fifth repetition is unknown: {fifth.why or 'its angles are unknown'}"
    return None


@dataclass(frozen=True)
class Published:
    """A published time limit of the five-times-sit-to-stand test."""

    limit: float  # time limit, s
    people: str  # group of people in the study
    meaning: str  # meaning of longer times according to the source
    # event at which the stopwatch was stopped; "not said" if the text available to us does not state it
    stop: Literal["fifth stand", "fifth seat contact", "not said"]
    source: str  # reference to the publication


_BOHANNON = "Bohannon, Percept Mot Skills 2006;103:215-222 (meta-analysis of 13 papers)"
_WORSE = "worse than average for the age"
_BUATOIS = "Buatois et al., J Am Geriatr Soc 2008;56:1575-1577"
_GURALNIK = "Guralnik et al., J Gerontol A 2000;55:M221-M231"
_DUNCAN = "Duncan et al., Arch Phys Med Rehabil 2011;92:1431"

PUBLISHED: tuple[Published, ...] = (
    Published(11.4, "60 to 69 years", _WORSE, "not said", _BOHANNON),
    Published(12.6, "70 to 79 years", _WORSE, "not said", _BOHANNON),
    Published(14.8, "80 to 89 years", _WORSE, "not said", _BOHANNON),
    Published(
        15.0,
        "2735 people of 65 years and older",
        "predicted recurrent falls with sensitivity 55 % and specificity 65 %",
        "not said",
        _BUATOIS,
    ),
    Published(13.6, "older people", "associated with increased disability and morbidity", "fifth stand", _GURALNIK),
    Published(
        16.0,
        "80 people with Parkinson's disease",
        "distinguished people who fall from others",
        "not said",
        _DUNCAN,
    ),
)
