"""Tables of what a protocol finds in a trial: repetitions of a movement, curls, and reaches."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from mocap_id.protocols.five_times import Attempt, FiveTimes
from mocap_id.reporting.grids import (
    UNKNOWN,
    Grid,
    GridColumn,
    columns_of,
    numbers,
    percent,
    show_ends,
    show_fixed,
    show_millimetres,
    texts,
    to_grid,
    to_words,
)
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import RangeEntry, RepetitionEntry, Summary, TargetEntry
from mocap_id.results import list_quantities


def list_repetitions(data: ReportData, summary: Summary) -> tuple[Grid, ...]:
    """Return the tables of repetitions, rises, failed attempts, test times, load shares and agreement of angles."""
    entries, five = summary.repetitions or [], summary.five_times
    events = to_grid(
        "Events of each repetition, on the clock of the recording",
        entries,
        (
            *columns_of(RepetitionEntry, "start_s seat_off_s stand_s seat_on_s end_s"),
            texts("complete", lambda entry: "yes" if entry.complete else "no"),
            texts("remark", lambda entry: entry.remark or ("" if entry.complete else entry.why)),
        ),
        "repetition",
    )

    def delay(entry: RepetitionEntry, name: str) -> str:
        """Format the time from seat-off to the seat-off by a different rule, in the attribute ``name``."""
        other = getattr(entry, name)
        return UNKNOWN if other is None or entry.seat_off_s is None else show_fixed(other - entry.seat_off_s, 3)

    rises = to_grid(
        "Each rise: seat-off (zero chair force), time from it to seat-off by the two rules of the thesis, greatest hip "
        "height as a share of the rise, time in pauses, failed attempts before it, and unexplained vertical force",
        entries if any(entry.reached is not None for entry in entries) else (),
        (
            numbers("seat-off (s)", "seat_off_s", 3),
            GridColumn("model agreement (s)", partial(delay, name="seat_off_model_s")),
            GridColumn("72 % of weight (s)", partial(delay, name="seat_off_72_s")),
            *columns_of(RepetitionEntry, "reached held_s attempts support"),
        ),
        "repetition",
    )
    found = summary.load_share
    shares = to_grid(
        f"Load shares of the feet; left foot on plate {found.left_plate}, right foot on plate {found.right_plate}",
        {phase: spread for phase, spread in found.left.items() if spread.mean is not None},
        (
            percent("left (%)", "mean"),
            percent("standard deviation (%)", "sd"),
            percent("right (%)", lambda spread: 1.0 - spread.mean),
        ),
        "phase",
    )
    agreement = to_grid(
        "Agreement of theta (zero on the segment lines) with the angles of another system. A negative r means the "
        "opposite sense; a minus sign before the column name in `compare:` corrects it",
        data.facts("phases.parquet").get("compared") or (),
        (
            texts("joint", "joint"),
            texts("column", "column"),
            numbers("r", "r", 4),
            numbers("mean difference (deg)", "offset_rad", 2, 180 / np.pi),
            numbers("rms without it (deg)", "rmse_rad", 2, 180 / np.pi),
            GridColumn("samples", lambda one: str(one.get("samples", ""))),
            texts("remark", "why"),
        ),
    )
    rows = {}
    for name, quantity in sorted(list_quantities(FiveTimes), key=lambda named: not named[1].unit):  # times, then counts
        value = getattr(five, name)
        if quantity.unit:
            sd = getattr(five, quantity.sd) if quantity.sd else None
            decimals = 2 if value is None or sd is None or sd >= 0.02 else 3
            spread = "" if value is None or sd is None else f" ± {show_fixed(sd, decimals)}"
            rows[f"{quantity.label} ({quantity.unit})"] = show_fixed(value, decimals) + spread
        elif name == "repetitions" or value:
            rows[quantity.label] = str(value)
    rows["why unknown"] = five.why or ""
    times = to_grid(
        "Five-times sit-to-stand test by both stop rules, from the start of the first rise, ± one standard deviation "
        "of the measurement (of the cycle: over the cycles). A stopwatch, which starts at the command, shows longer "
        "times",
        {name: value for name, value in rows.items() if value and five.repetitions is not None},
        [texts("value", str)],
        "quantity",
    )
    published = to_grid(
        "Published times, for context and not for diagnosis. The sources differ in chair, instruction and stop rule, "
        "and a motion-capture trial is not a clinical test",
        five.published if five.repetitions is not None and five.to_fifth_stand_s is not None else (),
        (
            GridColumn("longer than (s)", lambda one: f"{one.limit_s:g}"),
            texts("group", "people"),
            texts("meaning", "meaning"),
            texts("stop rule", "stop"),
            texts("source", "source"),
        ),
    )
    attempts = to_grid("Failed attempts to rise", summary.attempts or (), columns_of(Attempt))
    return events, rises, attempts, times, published, shares, agreement


def list_curls(data: ReportData, summary: Summary) -> tuple[Grid, Grid]:
    """Return tables of every curl and failed attempt, and of the angles that should not change in curls."""
    facts, rows = data.facts("events.parquet")["curl"], data.rows("events.parquet")

    def peak(row: tuple[Any, Mapping[str, Any] | None], who: str) -> str:
        torque = row[1]
        if torque is None or torque.get(f"{who}peak_Nm") is None:
            return UNKNOWN
        return f"{torque[f'{who}peak_Nm']:.1f} ± {torque[f'{who}sd_Nm']:.1f}"

    end = facts.get("end") or {}
    caption = "Curls, with the largest torque about the elbow's axis ± one standard deviation"
    if end.get("rule") not in {None, "recording"}:
        caption += f". The trial ends at {end['time_s']:.1f} s ({end['rule']}): {end['why']}"
    curls = to_grid(
        caption,
        zip(rows, facts.get("torque") or [None] * len(rows), strict=True),
        (
            numbers("start (s)", lambda row: row[0]["start"], 2),
            numbers("top (s)", lambda row: row[0]["top"], 2),
            numbers("end (s)", lambda row: row[0]["end"], 2),
            numbers("rise of the flexion (deg)", lambda row: row[0]["amplitude"], 0, 180 / np.pi),
            texts("complete", lambda row: "yes" if row[0]["complete"] else f"no: {row[0]['why']}"),
            GridColumn("largest torque (N·m)", partial(peak, who="")),
            GridColumn("of the person (N·m)", partial(peak, who="person_")),
        ),
    )
    compared = {}
    for name, found in summary.curls.compensation.items():
        ranges = [value for value in found.range_deg if value is not None]
        if not ranges:
            continue
        trend, change, in_step = summary.curls.fatigue.get(f"{name}_range_rad"), UNKNOWN, UNKNOWN
        if trend is not None:
            slope, low, high = np.degrees([trend.slope, *trend.interval])
            change = f"{slope:+.2f} ({low:+.2f} … {high:+.2f})"
        if found.in_step_deg is not None and found.in_step_interval_deg is not None:
            low, high = found.in_step_interval_deg
            in_step = f"{found.in_step_deg:.1f} ({low:.1f} … {high:.1f})"
        compared[name] = {
            "mean": np.mean(ranges),
            "largest": max(ranges),
            "errors": np.mean([value for value in found.floor_deg if value is not None]),
            "change": change,
            "sustained": str(sum(1 for one in found.sustained_s if one)),
            "in step": in_step,
        }
    compensation = to_grid(
        "Compensation: range of each angle within a curl. If it is below the range by errors alone, the angle may not "
        "move at all. Axial rotation excludes the part that follows the flexion in the first curl, because an error of "
        "the elbow's axis has the same effect",
        to_words(compared),
        (
            numbers("mean range (deg)", "mean", 1),
            numbers("largest range (deg)", "largest", 1),
            numbers("range by errors alone (deg)", "errors", 1),
            GridColumn("change per curl, 95 % interval (deg)", lambda row: row["change"]),
            GridColumn("curls with a sustained compensation", lambda row: row["sustained"]),
            GridColumn("excluded part that follows the flexion, 95 % interval (deg)", lambda row: row["in step"]),
        ),
        "angle",
    )
    return curls, compensation


def list_reach(data: ReportData, summary: Summary) -> tuple[Grid, ...]:
    """Return the tables of volumes, ranges of the angles, areas, heights, targets and reaches."""
    found, kinds = summary.workspace, {"box": "box of independent limits", "visited": "visited region"}
    volumes = to_grid(
        "Volume that the wrist can reach",
        [
            (kinds[name], one, found.relative_volume if one is found else None)
            for name, one in (("box", found), ("visited", found.visited))
            if one is not None and one.volume_m3 is not None
        ],
        (
            texts("set", 0),
            numbers("volume (m³)", lambda row: row[1].volume_m3, 4),
            GridColumn("95 % interval (m³)", lambda row: show_ends(row[1].interval_m3, 4)),
            numbers("fraction of a sphere with the arm's length as radius", 2, 3),
            GridColumn(
                "volume on finer and finer grids (m³)",
                lambda row: ", ".join(show_fixed(volume, 4) for volume in row[1].convergence_m3 or ()),
            ),
        ),
    )
    ranges = {}
    for name, one in (found.ranges or {}).items():
        parts = [share for key, share in (found.sources or {}).items() if key.startswith(name)]
        ranges[name] = {**dict(one), "contribution": sum(parts) if parts else None}
    of_angles = to_grid(
        "Ranges, robust against single samples: the angle is beyond each end for 0.05 s in total",
        to_words(ranges),
        (*columns_of(RangeEntry), percent("contribution to the variance of the volume (%)", "contribution")),
        "angle",
    )
    quadrants = ("total", "upper_medial", "upper_lateral", "lower_medial", "lower_lateral", "behind")
    areas = to_grid(
        "Relative area of the furthest reach about the shoulder. In front, 1 is half a sphere of the arm's length and "
        "0.25 a full quadrant; medial is towards the other arm",
        {kinds.get(name, name): one for name, one in (found.surface or {}).items()},
        [numbers(name.replace("_", " "), name, 3) for name in quadrants],
        "set",
    )
    levels: dict[str, tuple[str, str]] = {}
    if found.heights is not None:
        one_height = found.heights
        for end in ("highest", "lowest"):
            height, share = getattr(one_height, f"{end}_m"), getattr(one_height, f"{end}_share")
            levels[f"wrist, {end}"] = (show_millimetres(height), show_fixed(share, 2))
        for name, reached in one_height.levels.items():
            level = "an overhead shelf" if name == "overhead" else f"the {name}"
            levels[f"hand at the height of {level}"] = (UNKNOWN if reached is None else "yes" if reached else "no", "")
    heights = to_grid(
        "Heights above the shoulder, along the thorax",
        levels,
        (
            GridColumn("height (mm)", lambda row: row[0]),
            GridColumn("fraction of the arm's length", lambda row: row[1]),
        ),
        "level",
    )
    targets = to_grid(
        "Targets: part of the body nearest to the resting hand; positions from tables of proportions, ± 3 cm",
        to_words(found.tasks or {}),
        columns_of(TargetEntry),
        "target",
    )
    reaches = to_grid(
        "Reaches",
        [row for row in data.rows("events.parquet") if "target" in row],
        (
            numbers("start (s)", "start", 2),
            numbers("held (s)", "top", 2),
            numbers("end (s)", "end", 2),
            texts("target", lambda row: row["target"].replace("_", " ")),
            numbers("missed by (mm)", "miss_m", factor=1e3),
            texts("complete", lambda row: "yes" if row["complete"] else f"no: {row['why']}"),
        ),
    )
    return volumes, of_angles, areas, heights, targets, reaches
