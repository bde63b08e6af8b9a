"""Dynamics in ``summary.json``: motion of the masses, errors on left-out repetitions, effect of pinned joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mocap_id.reporting.dynamics_schema import GapEntry, HeldOutEntry, MotionEntry, PinsEntry, PredictedEntry
from mocap_id.reporting.numbers import to_number, to_numbers
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.robot_joint_summary import summarise_channels
from mocap_id.results import join_sentences, why_unknown

_PINNED = "the dynamics use the pinned chain"


def summarise_motion(data: ReportData) -> MotionEntry | None:
    """Return the entry on the motion of the masses; None if nothing was identified."""
    found = data.facts("dynamics.h5").get("motion")
    if found is None:
        return None
    order = () if data.skeleton is None else data.skeleton.joints
    gaps = found.get("joints") or {}
    joints = {name: _summarise_gap(gaps[name]) for name in sorted(gaps, key=lambda name: (*order, name).index(name))}
    return MotionEntry(
        source=found["source"],
        why=str(found["why"]),
        bands_hz=data.bands,
        bands_why=found.get("bands_why"),
        bodies=found.get("bodies"),
        prior=found.get("prior"),
        bodies_condition_number=to_number(found.get("bodies_condition_number")),
        bodies_condition_number_scaled=to_number(found.get("bodies_condition_number_scaled")),
        joints=joints or None,
    )


def summarise_pins(data: ReportData) -> PinsEntry:
    """Return the errors of the pinned chain and the measured poses on the same left-out repetitions."""
    facts = data.facts("dynamics.h5")
    found, samples = facts.get("pins") or {}, to_number((facts.get("pins") or {}).get("samples"))
    unknown = _PINNED if facts.get("motion") else facts.get("why") or data.why_missing("dynamics.h5")
    return PinsEntry.explain(
        found.get("why") or unknown,
        samples=None if samples is None else int(samples),
        chain=_summarise_prediction(found.get("chain")),
        segments=_summarise_prediction(found.get("segments")),
        clock_offset_s=to_number(found.get("clock_offset_s")),
    )


def summarise_held_out(data: ReportData) -> HeldOutEntry:
    """Return the prediction errors on left-out repetitions; null with a ``why`` if there are none."""
    facts = data.facts("dynamics.h5")
    found = facts.get("held_out") or {}
    counts = {key: to_number(found.get(key)) for key in ("repetitions", "folds", "samples")}
    model, within, reference = (
        summarise_channels(found.get(key)) or None for key in ("model", "in_sample", "reference")
    )
    unfiltered = model if data.low_pass is None else summarise_channels(found.get("unfiltered")) or None
    inside = {
        str(name): share for name, held in (found.get("inside") or {}).items() if (share := to_number(held)) is not None
    }
    offsets = to_numbers(found.get("clock_offset_s"))
    unknown = found.get("why") or facts.get("why") or data.why_missing("dynamics.h5")
    no_share = f"inside: {_PINNED}" if data.low_pass is None else "inside: at least two repetitions are needed"
    why = (
        why_unknown(unknown, *counts.values(), model, unfiltered, within, offsets),
        why_unknown("reference: there is no reference body", reference) if model is not None else None,
        why_unknown(no_share, inside or None) if model is not None else None,
    )
    return HeldOutEntry(
        **{key: None if count is None else int(count) for key, count in counts.items()},
        model=model,
        unfiltered=unfiltered,
        in_sample=within,
        reference=reference,
        clock_offset_s=offsets,
        inside=inside or None,
        why=join_sentences(why),
    )


def _summarise_gap(found: Mapping[str, Any]) -> GapEntry:
    return GapEntry.explain(
        "no interval without gaps is long enough",
        gap_m=to_number(found["gap_m"]),
        acceleration_m_s2=to_number(found["acceleration_m_s2"]),
        pinned=bool(found["pinned"]),
    )


def _summarise_prediction(found: Mapping[str, Any] | None) -> PredictedEntry | None:
    if found is None:
        return None
    why = "no sample has a centre of pressure"
    return PredictedEntry.explain(
        why, wrench=summarise_channels(found["wrench"]), cop_rms_m=to_number(found["cop_rms_m"])
    )
