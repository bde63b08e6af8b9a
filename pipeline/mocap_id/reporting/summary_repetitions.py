"""Repetitions in ``summary.json``: events, five-times test, failed attempts and load shares of the feet."""

from __future__ import annotations

from mocap_id.protocols.attempts import Attempt
from mocap_id.protocols.five_times import FiveTimes
from mocap_id.protocols.load_share import LoadShare
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import RepetitionEntry

_FILE = "events.parquet"


def summarise_repetitions(data: ReportData) -> list[RepetitionEntry] | None:
    """Return one entry for each repetition; None if repetitions were not searched for."""
    if data.table(_FILE) is None:
        return None
    entries = []
    for row in data.rows(_FILE):
        named = (name for name in RepetitionEntry.model_fields if name not in ("remark", "why"))
        found = RepetitionEntry.of(
            {name: row.get(name.removesuffix("_s")) for name in named} | {"remark": row["why"] or ""}
        )
        if None in [value for name, value in found if name != "why"]:
            why = found.remark or "the protocol has no such event, or it was not found"
            found = found.model_copy(update={"why": why})
        entries.append(found)
    return entries


def summarise_five_times(data: ReportData) -> FiveTimes:
    """Return the times of the five-times test; null with a ``why`` for other protocols."""
    facts = data.facts(_FILE).get("five_times")
    if facts is None:
        return FiveTimes(why=_explain_missing(data))
    found = FiveTimes.of(facts)
    stops = ("to_fifth_stand", "to_fifth_seat_contact", "to_fifth_seated")
    times = {stop: (getattr(found, f"{stop}_s"), getattr(found, f"{stop}_sd_s")) for stop in stops}
    spread = [stop for stop, (time, sd) in times.items() if time is not None and sd is None]
    why = found.why
    if why is None and spread:
        why = f"the standard deviation is unknown: {', '.join(spread)}; the rule for the contact gives none"
    elif why is None and None in (found.mean_cycle_s, found.cycle_sd_s, *(time for time, _ in times.values())):
        why = "fewer than three rises reach standing"
    return found.model_copy(update={"why": why})


def summarise_attempts(data: ReportData) -> list[Attempt] | None:
    """Return the failed attempts to rise; None for other protocols."""
    found = data.facts(_FILE).get("attempts")
    return None if found is None else [Attempt.of(one) for one in found]


def summarise_load_share(data: ReportData) -> LoadShare:
    """Return the fraction of the load on the left foot by phase; null with a ``why`` if unknown."""
    facts = data.facts(_FILE).get("load_share")
    if facts is None:
        return LoadShare(why=_explain_missing(data))
    found = LoadShare.of(facts)
    if found.why is None and any(None in (one.mean, one.sd) for one in found.left.values()):
        return found.model_copy(update={"why": "a phase occurs in fewer than two repetitions"})
    return found


def _explain_missing(data: ReportData) -> str:
    return "the protocol is not sit-to-stand" if _FILE in data.artefacts else data.why_missing(_FILE)
