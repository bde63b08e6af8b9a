"""Curls in the summary and on the page: counts, end of the trial, compensation, torque and fatigue."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id.reporting.grids import Grid, GridColumn, number, text, to_grid
from mocap_id.reporting.numbers import UNKNOWN, to_number
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.space.schema import CompensationEntry, CurlsEntry, TrendEntry
from mocap_id.reporting.space.tables import to_words

_FILE = "events.parquet"


def summarise_curls(data: ReportData) -> CurlsEntry:
    """Return counts, end of the trial, compensation, torque and fatigue; null with a ``why`` for other protocols."""
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
        end_s=to_number((facts.get("end") or {}).get("time_s")),
        end_rule=(facts.get("end") or {}).get("rule"),
        compensation={
            name: _summarise_compensation(found, (facts.get("in_step") or {}).get(name))
            for name, found in (facts.get("compensation") or {}).items()
        },
        largest_torque_nm=None if peak is None else peak["peak_Nm"],
        largest_torque_sd_nm=None if peak is None else peak["sd_Nm"],
        fatigue={
            name: _summarise_trend(found) for name, found in (facts.get("fatigue") or {}).items() if found is not None
        },
        why=facts.get("why") or facts.get("torque_why") or None,
    )


def _summarise_compensation(found: list[dict[str, Any] | None], in_step: Mapping[str, Any] | None) -> CompensationEntry:
    """Return the compensation of one angle, degrees.

    ``found`` has an entry for each curl, None for a failed attempt; ``in_step`` is the part of the angle that depends
    on the flexion alone, None if it is not separated.
    """

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


def _summarise_trend(found: Mapping[str, Any]) -> TrendEntry:
    return TrendEntry(slope=found["slope"], interval=found["interval"], curls=found["count"])


def list_curls(data: ReportData) -> Grid:
    """Return a table with a row for every curl and every failed attempt; empty for other protocols."""
    facts = data.facts(_FILE).get("curl") or {}
    rows = data.rows(_FILE) if facts else []
    columns = (
        number("start (s)", lambda row: row[0]["start"], 2),
        number("top (s)", lambda row: row[0]["top"], 2),
        number("end (s)", lambda row: row[0]["end"], 2),
        number("rise of the flexion (deg)", lambda row: row[0]["amplitude"], 0, 180 / np.pi),
        text("complete", lambda row: "yes" if row[0]["complete"] else f"no: {row[0]['why']}"),
        GridColumn("largest torque (N·m)", lambda row: _show_peak(row[1], "")),
        GridColumn("of the person (N·m)", lambda row: _show_peak(row[1], "person_")),
    )
    end = facts.get("end") or {}
    caption = "Curls, with the largest torque about the elbow's axis ± one standard deviation"
    if end.get("rule") not in {None, "recording"}:
        caption += f". The trial ends at {end['time_s']:.1f} s ({end['rule']}): {end['why']}"
    torques = facts.get("torque") or [None] * len(rows)
    return to_grid(caption, zip(rows, torques, strict=True), columns)


def _show_peak(torque: Mapping[str, Any] | None, who: str) -> str:
    if torque is None or torque.get(f"{who}peak_Nm") is None:
        return UNKNOWN
    return f"{torque[f'{who}peak_Nm']:.1f} ± {torque[f'{who}sd_Nm']:.1f}"


def list_compensation(data: ReportData) -> Grid:
    """Return a table of the ranges of every angle that should not change, and the range that errors alone can cause."""
    entry = summarise_curls(data)
    rows = {
        name: (found, entry.fatigue.get(f"{name}_range_rad"))
        for name, found in entry.compensation.items()
        if _remove_missing(found.range_deg)
    }
    columns = (
        number("mean range (deg)", lambda row: np.mean(_remove_missing(row[0].range_deg)), 1),
        number("largest range (deg)", lambda row: max(_remove_missing(row[0].range_deg)), 1),
        number("range by errors alone (deg)", lambda row: np.mean(_remove_missing(row[0].floor_deg)), 1),
        GridColumn("change per curl, 95 % interval (deg)", lambda row: _show_change(row[1])),
        GridColumn("curls with a sustained compensation", lambda row: str(sum(1 for one in row[0].sustained_s if one))),
        GridColumn("excluded part that follows the flexion, 95 % interval (deg)", lambda row: _show_in_step(row[0])),
    )
    caption = (
        "Compensation: range of each angle within a curl. If it is below the range by errors alone, the angle may not "
        "move at all. Axial rotation excludes the part that follows the flexion in the first curl, because an error of "
        "the elbow's axis has the same effect"
    )
    return to_grid(caption, to_words(rows), columns, "angle")


def _remove_missing(values: list[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _show_change(trend: TrendEntry | None) -> str:
    """Format the change per curl, degrees, with its interval; return a dash if it is unknown."""
    if trend is None:
        return UNKNOWN
    slope, low, high = np.degrees([trend.slope, *trend.interval])
    return f"{slope:+.2f} ({low:+.2f} … {high:+.2f})"


def _show_in_step(found: CompensationEntry) -> str:
    if found.in_step_deg is None or found.in_step_interval_deg is None:
        return UNKNOWN
    low, high = found.in_step_interval_deg
    return f"{found.in_step_deg:.1f} ({low:.1f} … {high:.1f})"
