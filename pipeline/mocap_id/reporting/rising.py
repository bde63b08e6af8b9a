"""The report's tables about repetitions: events, seat-off by each rule, the five-times test, shares, other angles."""

from __future__ import annotations

import numpy as np

from mocap_id.reporting.material import Material
from mocap_id.reporting.numbers import UNKNOWN, known, show_fixed
from mocap_id.reporting.shape import RepetitionEntry, Summary
from mocap_id.reporting.tables import Grid, grid

_PHASES = {"seated": "on the chair", "rising": "start to standing", "standing": "standing"}


def repetitions(summary: Summary) -> Grid:
    """The events of each repetition."""
    rows = [
        (
            str(k),
            *(show_fixed(t, 2) for t in (entry.start_s, entry.seat_off_s, entry.stand_s, entry.seat_on_s, entry.end_s)),
            "yes" if entry.complete else "no",
            entry.remark or ("" if entry.complete else entry.why or ""),
        )
        for k, entry in enumerate(summary.repetitions or (), start=1)
    ]
    head = ("", "start (s)", "seat-off (s)", "standing (s)", "seat-on (s)", "end (s)", "complete", "remark")
    return grid("Repetitions, in the recording's own clock", head, rows, (0, 6, 7))


def seat_off(summary: Summary) -> Grid:
    """Seat-off by each rule, and how high and how steadily the person rises; nothing where no repetition has it."""
    found = summary.repetitions or []
    rows = []
    for k, entry in enumerate(found, start=1):
        rows.append(
            (
                str(k),
                show_fixed(entry.seat_off_s, 3),
                _before(entry, entry.seat_off_model_s),
                _before(entry, entry.seat_off_72_s),
                _percent(entry.reached),
                show_fixed(entry.held_s, 1),
                UNKNOWN if entry.attempts is None else str(entry.attempts),
                _percent(entry.support),
            )
        )
    told = any(entry.reached is not None for entry in found)
    caption = (
        "Each rise: seat-off where the chair's force vanishes, and by the thesis's two rules how long before that; how "
        "high the hips come, time in pauses, failed attempts before, vertical force that neither plates nor chair "
        "explain"
    )
    head = (
        "",
        "seat-off (s)",
        "measured meets model (s)",
        "72 % under the feet (s)",
        "height (%)",
        "paused (s)",
        "attempts",
        "unexplained (% of weight)",
    )
    return grid(caption, head, rows if told else (), (0,))


def attempts(summary: Summary) -> Grid:
    """Rises that were broken off."""
    rows = [(show_fixed(one.time_s, 2), _percent(one.height), _percent(one.unloaded)) for one in summary.attempts or ()]
    head = ("at (s)", "height of the hips (% of the rise)", "lifted off the chair (% of its load)")
    return grid("Rises that were broken off", head, rows, ())


def five_times(summary: Summary) -> Grid:
    """The five-times-sit-to-stand test; nothing where the protocol has none."""
    found = summary.five_times
    if found.repetitions is None:
        return grid("", (), ())
    spread = "" if found.cycle_sd_s is None else f" ± {show_fixed(found.cycle_sd_s, 2)}"
    cycle = UNKNOWN if found.mean_cycle_s is None else show_fixed(found.mean_cycle_s, 2) + spread
    rows = [
        ("start of the first rise to the fifth stand (s)", show_fixed(found.to_fifth_stand_s, 2)),
        ("start of the first rise to the fifth seat contact (s)", show_fixed(found.to_fifth_seat_contact_s, 2)),
        ("start of the first rise to rest on the seat (s)", show_fixed(found.to_fifth_seated_s, 2)),
        ("from one stand to the next (s)", cycle),
        ("rises that come to standing", str(found.repetitions)),
    ]
    if found.failed_attempts:
        rows.append(("failed attempts within the time", str(found.failed_attempts)))
    if found.why:
        rows.append(("not known, because", found.why))
    caption = "Five-times sit-to-stand, by both stop rules; a stopwatch starts at the command and reads more"
    return grid(caption, ("what", "value"), rows, (0, 1))


def published(summary: Summary) -> Grid:
    """Published times beside the trial's; only where the trial has one."""
    found = summary.five_times
    if found.to_fifth_stand_s is None:
        return grid("", (), ())
    rows = [(f"{one.limit_s:g}", one.people, one.meaning, one.stop, one.source) for one in found.published]
    caption = (
        "Published times, as context and not as a diagnosis: sources differ in chair, instruction and stop rule, and a "
        "recording with markers is no clinical test"
    )
    return grid(caption, ("longer than (s)", "people", "meaning", "clock stopped at", "source"), rows, (1, 2, 3, 4))


def load_share(summary: Summary) -> Grid:
    """The left foot's share of the feet's load."""
    found = summary.load_share
    rows = [
        (
            _PHASES[phase],
            _percent(spread.mean),
            _percent(spread.sd),
            _percent(None if spread.mean is None else 1.0 - spread.mean),
        )
        for phase, spread in found.left.items()
        if spread.mean is not None
    ]
    caption = (
        f"Share of the feet's load: left foot on plate {found.left_plate}, right foot on plate {found.right_plate}"
    )
    head = ("phase", "left (%)", "standard deviation (%)", "right (%)")
    return grid(caption if rows else "", head, rows, (0,))


def compared(material: Material) -> Grid:
    """How another system's angles agree with these."""
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
        for one in material.facts("phases.parquet").get("compared") or ()
    ]
    caption = (
        "Another system's angles beside these, as given: where r is negative it counts the other way round (a minus "
        "before the column turns it)"
    )
    head = ("joint", "column", "r", "its mean is more by (deg)", "rms without that (deg)", "samples", "remark")
    return grid(caption, head, rows, (0, 1, 6))


def _degrees(angle: object) -> str:
    number = known(angle)
    return UNKNOWN if number is None else show_fixed(np.degrees(number), 2)


def _before(entry: RepetitionEntry, other: float | None) -> str:
    if other is None or entry.seat_off_s is None:
        return UNKNOWN
    return show_fixed(other - entry.seat_off_s, 3)


def _percent(share: float | None) -> str:
    return UNKNOWN if share is None else show_fixed(100 * share, 1)
