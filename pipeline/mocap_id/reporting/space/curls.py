"""Curls in the summary and on the page: counts, end of the trial, compensation, torque and fatigue."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id.reporting.numbers import UNKNOWN, known, show_fixed
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.space.schema import CompensationEntry, CurlsEntry, TrendEntry
from mocap_id.reporting.tables import Grid, grid

_FILE = "events.parquet"


def curls(data: ReportData) -> CurlsEntry:
    """Return counts, end, compensation, torque and fatigue; null with a ``why`` for other protocols."""
    facts = data.facts(_FILE).get("curl")
    if facts is None:
        return CurlsEntry(why="only `protocol: curl` counts curls")
    torque = [one for one in facts.get("torque") or () if one is not None]
    peak = max(torque, key=lambda one: one["peak_Nm"], default=None)
    return CurlsEntry(
        count=facts.get("count"),
        partial=facts.get("partial"),
        after_end=facts.get("after_end"),
        condition=facts.get("condition"),
        end_s=known((facts.get("end") or {}).get("time_s")),
        end_rule=(facts.get("end") or {}).get("rule"),
        compensation={
            name: _compensation(found, (facts.get("in_step") or {}).get(name))
            for name, found in (facts.get("compensation") or {}).items()
        },
        largest_torque_nm=None if peak is None else peak["peak_Nm"],
        largest_torque_sd_nm=None if peak is None else peak["sd_Nm"],
        fatigue={name: _trend(found) for name, found in (facts.get("fatigue") or {}).items() if found is not None},
        why=facts.get("why") or facts.get("torque_why") or None,
    )


def _compensation(found: list[dict[str, Any] | None], in_step: Mapping[str, Any] | None) -> CompensationEntry:
    """Return the compensation of one angle in degrees, None for a curl without it."""

    def degrees(value: float) -> float:
        return float(np.degrees(value))

    there = [one or {} for one in found]
    return CompensationEntry(
        range_deg=[degrees(one["range_rad"]) if one else None for one in there],
        interval_deg=[[degrees(end) for end in one["interval_rad"]] if one else None for one in there],
        floor_deg=[degrees(one["floor_rad"]) if one else None for one in there],
        offset_deg=[degrees(one["offset_rad"]) if one else None for one in there],
        sustained_s=[one["sustained_s"] if one else None for one in there],
        in_step_deg=None if in_step is None else degrees(in_step["range_rad"]),
        in_step_interval_deg=None if in_step is None else [degrees(end) for end in in_step["interval_rad"]],
    )


def _trend(found: Mapping[str, Any]) -> TrendEntry:
    return TrendEntry(slope=found["slope"], interval=found["interval"], curls=found["count"])


def counts(data: ReportData) -> Grid:
    """Return one row for every curl and failed attempt."""
    table, facts = data.table(_FILE), data.facts(_FILE).get("curl")
    rows = []
    if table is not None and facts is not None:
        torques = facts.get("torque") or [None] * table.length
        columns = [table[name] for name in ("start", "top", "end", "amplitude", "complete", "why")]
        for (start, top, end, rise, complete, why), torque in zip(zip(*columns, strict=True), torques, strict=True):
            times = [show_fixed(known(time), 2) for time in (start, top, end)]
            peaks = [_peak(torque, who) for who in ("", "person_")]
            rows.append((*times, show_fixed(float(np.degrees(rise)), 0), "yes" if complete else f"no: {why}", *peaks))
    head = (
        "start (s)",
        "top (s)",
        "end (s)",
        "rise of the flexion (deg)",
        "complete",
        "largest torque (N·m)",
        "of the person (N·m)",
    )
    ended = (facts or {}).get("end") or {}
    caption = "Curls, with the largest torque about the elbow's axis ± one standard deviation"
    if ended.get("rule") not in {None, "recording"}:
        caption += f". The trial ends at {ended['time_s']:.1f} s ({ended['rule']}): {ended['why']}"
    return grid(caption, head, rows, (4,))


def _peak(torque: Mapping[str, Any] | None, who: str) -> str:
    if torque is None or torque.get(f"{who}peak_Nm") is None:
        return UNKNOWN
    return f"{torque[f'{who}peak_Nm']:.1f} ± {torque[f'{who}sd_Nm']:.1f}"


def compensation(data: ReportData) -> Grid:
    """Return the mean range of every angle that should not move, beside the range that errors alone can show."""
    entry = curls(data)
    rows = []
    for name, found in entry.compensation.items():
        ranges = [one for one in found.range_deg if one is not None]
        floors = [one for one in found.floor_deg if one is not None]
        if not ranges:
            continue
        slope = entry.fatigue.get(f"{name}_range_rad")
        trend = UNKNOWN
        if slope is not None:
            low, high = (float(np.degrees(end)) for end in slope.interval)
            trend = f"{np.degrees(slope.slope):+.2f} ({low:+.2f} … {high:+.2f})"
        long = sum(1 for one in found.sustained_s if one)
        cells = (
            show_fixed(float(np.mean(ranges)), 1),
            show_fixed(max(ranges), 1),
            show_fixed(float(np.mean(floors)), 1),
        )
        rows.append((name.replace("_", " "), *cells, trend, str(long), _in_step(found)))
    head = (
        *("angle", "mean range (deg)", "largest range (deg)", "range by errors alone (deg)"),
        *("change per curl, 95 % interval (deg)", "curls with a sustained compensation"),
        "also in step with the flexion, 95 % interval (deg)",
    )
    caption = (
        "Compensation: range of each angle within a curl. A range below that by errors alone may be no motion. Axial "
        "rotation excludes the part in step with the flexion in the first curl, because an error of the elbow's axis "
        "looks the same"
    )
    return grid(caption, head, rows)


def _in_step(found: CompensationEntry) -> str:
    if found.in_step_deg is None or found.in_step_interval_deg is None:
        return UNKNOWN
    low, high = found.in_step_interval_deg
    return f"{found.in_step_deg:.1f} ({low:.1f} … {high:.1f})"
