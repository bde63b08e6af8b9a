"""Repetitions in ``summary.json``: events, five-times test, failed attempts and load shares of the feet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mocap_id.reporting.numbers import to_number
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import (
    AttemptEntry,
    FiveTimesEntry,
    LoadShareEntry,
    PublishedEntry,
    RepetitionEntry,
    SpreadEntry,
)

EVENTS = ("start", "seat_off", "stand", "seat_on", "end")
"""Events of a repetition in order of time."""

PHASES = ("seated", "rising", "standing")

_STOPS = ("to_fifth_stand", "to_fifth_seat_contact", "to_fifth_seated")
_TIMES = (*(f"{stop}{part}_s" for stop in _STOPS for part in ("", "_sd")), "mean_cycle_s", "cycle_sd_s")
_FILE = "events.parquet"


def summarise_repetitions(data: ReportData) -> list[RepetitionEntry] | None:
    """Return one entry for each repetition; None if repetitions were not searched for."""
    return None if data.table(_FILE) is None else [_summarise_repetition(row) for row in data.rows(_FILE)]


def summarise_five_times(data: ReportData) -> FiveTimesEntry:
    """Return the times of the five-times test; null with a ``why`` for other protocols."""
    facts = data.facts(_FILE).get("five_times")
    if facts is None:
        nothing = dict.fromkeys(_TIMES)
        why = _explain_missing(data)
        return FiveTimesEntry(repetitions=None, failed_attempts=None, published=[], why=why, **nothing)
    times = {name: to_number(facts.get(name)) for name in _TIMES}
    why = facts.get("why")
    if why is None and any(value is None for value in times.values()):
        spread = [stop for stop in _STOPS if times[f"{stop}_s"] is not None and times[f"{stop}_sd_s"] is None]
        why = "fewer than three rises reach standing"
        if spread:
            why = f"the standard deviation is unknown: {', '.join(spread)}; the rule for the contact gives none"
    return FiveTimesEntry(
        repetitions=int(facts["repetitions"]),
        failed_attempts=int(facts["failed_attempts"]),
        published=[PublishedEntry(**one) for one in facts.get("published") or ()],
        why=why,
        **times,
    )


def summarise_attempts(data: ReportData) -> list[AttemptEntry] | None:
    """Return the failed attempts to rise; None for other protocols."""
    found = data.facts(_FILE).get("attempts")
    if found is None:
        return None
    return [
        AttemptEntry(time_s=float(one["time_s"]), height=float(one["height"]), unloaded=to_number(one.get("unloaded")))
        for one in found
    ]


def summarise_load_share(data: ReportData) -> LoadShareEntry:
    """Return the fraction of the load on the left foot by phase; null with a ``why`` if unknown."""
    facts = data.facts(_FILE).get("load_share")
    if facts is None:
        nothing = {phase: SpreadEntry(mean=None, sd=None) for phase in PHASES}
        return LoadShareEntry(left_plate=None, right_plate=None, left=nothing, why=_explain_missing(data))
    left: dict[str, SpreadEntry] = {}
    for phase in PHASES:
        spread: Mapping[str, Any] = facts["left"].get(phase) or {}
        left[phase] = SpreadEntry(mean=to_number(spread.get("mean")), sd=to_number(spread.get("sd")))
    why = facts.get("why")
    if why is None and any(None in (one.mean, one.sd) for one in left.values()):
        why = "a phase occurs in fewer than two repetitions"
    return LoadShareEntry(left_plate=facts["left_plate"], right_plate=facts["right_plate"], left=left, why=why)


def _explain_missing(data: ReportData) -> str:
    if _FILE not in data.artefacts:
        return data.why_missing(_FILE)
    return "the protocol is not sit-to-stand"


def _summarise_repetition(row: Mapping[str, object]) -> RepetitionEntry:
    times = {f"{event}_s": to_number(row[event]) for event in EVENTS}
    details = {
        "seat_off_72_s": to_number(row.get("seat_off_72")),
        "seat_off_model_s": to_number(row.get("seat_off_model")),
        "reached": to_number(row.get("reached")),
        "held_s": to_number(row.get("held")),
        "support": to_number(row.get("support")),
    }
    attempts_before, remark = to_number(row.get("attempts")), str(row["why"] or "")
    unknown = None in (*times.values(), *details.values(), attempts_before)
    return RepetitionEntry(
        **times,
        **details,
        attempts=None if attempts_before is None else int(attempts_before),
        complete=bool(row["complete"]),
        remark=remark,
        why=(remark or "the protocol has no such event, or it was not found") if unknown else None,
    )
