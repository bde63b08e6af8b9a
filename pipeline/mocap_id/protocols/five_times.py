"""Times of the five-times-sit-to-stand test by the common stop rules, and published times for comparison.

A stopwatch starts at the command, so its times also contain the reaction time. The published times are not a diagnosis,
because their sources differ in chair, instruction and stop rule.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from mocap_id.arrays import FloatArray
from mocap_id.protocols.posture import STANDING
from mocap_id.protocols.repetitions import Repetition, RiseDetails
from mocap_id.results import Quantity, Result

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
_BUATOIS = "Buatois et al., J Am Geriatr Soc 2008;56:1575-1577"
_GURALNIK = "Guralnik et al., J Gerontol A 2000;55:M221-M231"
_DUNCAN = "Duncan et al., Arch Phys Med Rehabil 2011;92:1431"

PUBLISHED = [
    Published(limit_s=limit, people=people, meaning=meaning, stop=stop, source=source)
    for limit, people, meaning, stop, source in (
        (11.4, "60 to 69 years", _WORSE, "not said", _BOHANNON),
        (12.6, "70 to 79 years", _WORSE, "not said", _BOHANNON),
        (14.8, "80 to 89 years", _WORSE, "not said", _BOHANNON),
        (
            15.0,
            "2735 people of 65 years and older",
            "predicted recurrent falls with sensitivity 55 % and specificity 65 %",
            "not said",
            _BUATOIS,
        ),
        (13.6, "older people", "associated with increased disability and morbidity", "fifth stand", _GURALNIK),
        (
            16.0,
            "80 people with Parkinson's disease",
            "distinguished people who fall from others",
            "not said",
            _DUNCAN,
        ),
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
        Quantity("cycle, stand to stand", "s", "cycle_sd_s", "cycle", "mean time from stand to stand"),
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
