"""Tables of the report about repetitions: events, seat-off, five-times test, load shares and other angles."""

from __future__ import annotations

import numpy as np

from mocap_id.protocols.five_times import FiveTimes
from mocap_id.reporting.grids import Grid, GridColumn, number, percent, text, to_grid
from mocap_id.reporting.numbers import UNKNOWN, show_fixed
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import RepetitionEntry, Summary
from mocap_id.results import list_quantities


def list_repetitions(summary: Summary) -> Grid:
    """Return a table of the events of each repetition."""
    columns = (
        number("start (s)", "start_s", 2),
        number("seat-off (s)", "seat_off_s", 2),
        number("standing (s)", "stand_s", 2),
        number("seat-on (s)", "seat_on_s", 2),
        number("end (s)", "end_s", 2),
        text("complete", lambda entry: "yes" if entry.complete else "no"),
        text("remark", lambda entry: entry.remark or ("" if entry.complete else entry.why)),
    )
    caption = "Events of each repetition, on the clock of the recording"
    return to_grid(caption, summary.repetitions or (), columns, "repetition")


def list_seat_off_times(summary: Summary) -> Grid:
    """Return a table of the rises: seat-off by each rule, height, pauses, failed attempts and unexplained force.

    The table is empty if no rise has a known height.
    """
    columns = (
        number("seat-off (s)", "seat_off_s", 3),
        _make_delay_column("model agreement (s)", "seat_off_model_s"),
        _make_delay_column("72 % of weight (s)", "seat_off_72_s"),
        percent("height (%)", "reached"),
        number("paused (s)", "held_s", 1),
        number("failed attempts", "attempts", 0),
        percent("unexplained force (% of weight)", "support"),
    )
    caption = (
        "Each rise: seat-off (zero chair force), time from it to seat-off by the two rules of the thesis, greatest hip "
        "height as a share of the rise, time in pauses, failed attempts before it, and unexplained vertical force"
    )
    entries = summary.repetitions or []
    has_rises = any(entry.reached is not None for entry in entries)
    return to_grid(caption, entries if has_rises else (), columns, "repetition")


def _make_delay_column(head: str, name: str) -> GridColumn:
    """Return the column of the time from seat-off to the seat-off by a different rule, in the attribute ``name``."""

    def cell(entry: RepetitionEntry) -> str:
        other = getattr(entry, name)
        return UNKNOWN if other is None or entry.seat_off_s is None else show_fixed(other - entry.seat_off_s, 3)

    return GridColumn(head, cell)


def list_attempts(summary: Summary) -> Grid:
    """Return a table of the failed attempts to rise."""
    columns = (
        number("time (s)", "time_s", 2),
        percent("hip height (% of the rise)", "height"),
        percent("unloading of the chair (% of its load)", "unloaded"),
    )
    return to_grid("Failed attempts to rise", summary.attempts or (), columns)


def list_test_times(summary: Summary) -> Grid:
    """Return a table of the times of the five-times sit-to-stand test; empty for other protocols."""
    found = summary.five_times
    if found.repetitions is None:
        return Grid()
    rows = {}
    for name, quantity in sorted(list_quantities(FiveTimes), key=lambda named: not named[1].unit):  # times, then counts
        value = getattr(found, name)
        if quantity.unit:
            rows[f"{quantity.label} ({quantity.unit})"] = _show_time(value, getattr(found, quantity.sd))
        elif name == "repetitions" or value:
            rows[quantity.label] = str(value)
    rows["why unknown"] = found.why or ""
    caption = (
        "Five-times sit-to-stand test by both stop rules, from the start of the first rise, ± one standard deviation "
        "of the measurement (of the cycle: over the cycles). A stopwatch, which starts at the command, shows longer "
        "times"
    )
    return to_grid(caption, {name: value for name, value in rows.items() if value}, [text("value", str)], "quantity")


def _show_time(seconds: float | None, sd: float | None) -> str:
    """Format a time in s with its standard deviation; the latter is omitted if it is unknown."""
    shown = show_fixed(seconds, 2)
    if seconds is None or sd is None:
        return shown
    return f"{shown} ± {show_fixed(sd, 2)}" if sd >= 0.02 else f"{show_fixed(seconds, 3)} ± {show_fixed(sd, 3)}"


def list_published_times(summary: Summary) -> Grid:
    """Return a table of published test times for comparison; empty if the trial has no time to the fifth stand."""
    columns = (
        GridColumn("longer than (s)", lambda one: f"{one.limit_s:g}"),
        text("group", "people"),
        text("meaning", "meaning"),
        text("stop rule", "stop"),
        text("source", "source"),
    )
    caption = (
        "Published times, for context and not for diagnosis. The sources differ in chair, instruction and stop rule, "
        "and a motion-capture trial is not a clinical test"
    )
    found = summary.five_times
    return to_grid(caption, found.published if found.to_fifth_stand_s is not None else (), columns)


def list_load_shares(summary: Summary) -> Grid:
    """Return a table of the fractions of the load on the left and the right foot, by phase; empty if unknown."""
    found = summary.load_share
    columns = (
        percent("left (%)", "mean"),
        percent("standard deviation (%)", "sd"),
        percent("right (%)", lambda spread: 1.0 - spread.mean),
    )
    caption = f"Load shares of the feet; left foot on plate {found.left_plate}, right foot on plate {found.right_plate}"
    known_phases = {phase: spread for phase, spread in found.left.items() if spread.mean is not None}
    return to_grid(caption, known_phases, columns, "phase")


def list_agreement(data: ReportData) -> Grid:
    """Return a table of the agreement with the angles of another system."""
    columns = (
        text("joint", "joint"),
        text("column", "column"),
        number("r", "r", 4),
        number("mean difference (deg)", "offset_rad", 2, 180 / np.pi),
        number("rms without it (deg)", "rmse_rad", 2, 180 / np.pi),
        GridColumn("samples", lambda one: str(one.get("samples", ""))),
        text("remark", "why"),
    )
    caption = (
        "Agreement of theta (zero on the segment lines) with the angles of another system. A negative r means the "
        "opposite sense; a minus sign before the column name in `compare:` corrects it"
    )
    return to_grid(caption, data.facts("phases.parquet").get("compared") or (), columns)
