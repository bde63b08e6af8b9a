"""Tables of the report about repetitions: events, seat-off, five-times test, load shares and other angles."""

from __future__ import annotations

import numpy as np

from mocap_id.reporting.numbers import UNKNOWN, known, show_fixed
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import RepetitionEntry, Summary
from mocap_id.reporting.tables import Grid, grid, percent

_PHASES = {"seated": "seated", "rising": "rising", "standing": "standing"}


def repetitions(summary: Summary) -> Grid:
    """Return the events of each repetition."""
    rows = [
        (
            str(k),
            *(show_fixed(t, 2) for t in (entry.start_s, entry.seat_off_s, entry.stand_s, entry.seat_on_s, entry.end_s)),
            "yes" if entry.complete else "no",
            entry.remark or ("" if entry.complete else entry.why or ""),
        )
        for k, entry in enumerate(summary.repetitions or (), start=1)
    ]
    head = ("repetition", "start (s)", "seat-off (s)", "standing (s)", "seat-on (s)", "end (s)", "complete", "remark")
    return grid("Events of each repetition, on the clock of the recording", head, rows, (0, 6, 7))


def seat_off(summary: Summary) -> Grid:
    """Return seat-off by each rule, and height, pauses, attempts and support of each rise; empty if unknown."""
    found = summary.repetitions or []
    rows = [
        (
            str(k),
            show_fixed(entry.seat_off_s, 3),
            _before(entry, entry.seat_off_model_s),
            _before(entry, entry.seat_off_72_s),
            percent(entry.reached),
            show_fixed(entry.held_s, 1),
            UNKNOWN if entry.attempts is None else str(entry.attempts),
            percent(entry.support),
        )
        for k, entry in enumerate(found, start=1)
    ]
    known_rises = any(entry.reached is not None for entry in found)
    caption = (
        "Each rise: seat-off (zero chair force), time from it to seat-off by the two rules of the thesis, greatest hip "
        "height as a share of the rise, time in pauses, failed attempts before it, and unexplained vertical force"
    )
    head = (
        "repetition",
        "seat-off (s)",
        "model agreement (s)",
        "72 % of weight (s)",
        "height (%)",
        "paused (s)",
        "failed attempts",
        "unexplained force (% of weight)",
    )
    return grid(caption, head, rows if known_rises else (), (0,))


def attempts(summary: Summary) -> Grid:
    """Return the failed attempts to rise."""
    rows = [(show_fixed(one.time_s, 2), percent(one.height), percent(one.unloaded)) for one in summary.attempts or ()]
    head = ("time (s)", "hip height (% of the rise)", "unloading of the chair (% of its load)")
    return grid("Failed attempts to rise", head, rows, ())


def five_times(summary: Summary) -> Grid:
    """Return the times of the five-times-sit-to-stand test; empty for other protocols."""
    found = summary.five_times
    if found.repetitions is None:
        return grid("", (), ())
    spread = "" if found.cycle_sd_s is None else f" ± {show_fixed(found.cycle_sd_s, 2)}"
    cycle = UNKNOWN if found.mean_cycle_s is None else show_fixed(found.mean_cycle_s, 2) + spread
    rows = [
        ("first rise to fifth stand (s)", show_fixed(found.to_fifth_stand_s, 2)),
        ("first rise to fifth seat contact (s)", show_fixed(found.to_fifth_seat_contact_s, 2)),
        ("first rise to seated rest (s)", show_fixed(found.to_fifth_seated_s, 2)),
        ("cycle, stand to stand (s)", cycle),
        ("rises that reach standing", str(found.repetitions)),
    ]
    if found.failed_attempts:
        rows.append(("failed attempts within this time", str(found.failed_attempts)))
    if found.why:
        rows.append(("why unknown", found.why))
    caption = (
        "Five-times sit-to-stand test by both stop rules, from the start of the first rise. A stopwatch, which starts "
        "at the command, shows longer times"
    )
    return grid(caption, ("quantity", "value"), rows, (0, 1))


def published(summary: Summary) -> Grid:
    """Return published test times for comparison; empty if the trial has no time."""
    found = summary.five_times
    if found.to_fifth_stand_s is None:
        return grid("", (), ())
    rows = [(f"{one.limit_s:g}", one.people, one.meaning, one.stop, one.source) for one in found.published]
    caption = (
        "Published times, for context and not for diagnosis. The sources differ in chair, instruction and stop rule, "
        "and a motion-capture trial is not a clinical test"
    )
    return grid(caption, ("longer than (s)", "group", "meaning", "stop rule", "source"), rows, (1, 2, 3, 4))


def load_share(summary: Summary) -> Grid:
    """Return the load shares of the left and right foot."""
    found = summary.load_share
    rows = [
        (
            _PHASES[phase],
            percent(spread.mean),
            percent(spread.sd),
            percent(None if spread.mean is None else 1.0 - spread.mean),
        )
        for phase, spread in found.left.items()
        if spread.mean is not None
    ]
    caption = f"Load shares of the feet; left foot on plate {found.left_plate}, right foot on plate {found.right_plate}"
    head = ("phase", "left (%)", "standard deviation (%)", "right (%)")
    return grid(caption if rows else "", head, rows, (0,))


def compared(data: ReportData) -> Grid:
    """Return the agreement with the angles of another system."""
    rows = [
        (
            str(one["joint"]),
            str(one["column"]),
            show_fixed(one.get("r"), 4),
            _degrees(one.get("offset_rad")),
            _degrees(one.get("rmse_rad")),
            str(one.get("samples", "")),
            str(one.get("why") or ""),
        )
        for one in data.facts("phases.parquet").get("compared") or ()
    ]
    caption = (
        "Agreement with the angles of another system. A negative r means the opposite sense; a minus sign before the "
        "column name in `compare:` corrects it"
    )
    head = ("joint", "column", "r", "mean difference (deg)", "rms without it (deg)", "samples", "remark")
    return grid(caption, head, rows, (0, 1, 6))


def _degrees(angle: object) -> str:
    number = known(angle)
    return UNKNOWN if number is None else show_fixed(np.degrees(number), 2)


def _before(entry: RepetitionEntry, other: float | None) -> str:
    if other is None or entry.seat_off_s is None:
        return UNKNOWN
    return show_fixed(other - entry.seat_off_s, 3)
