"""Tables of the report about joints, angles and landmarks in space."""

from __future__ import annotations

import math

from mocap_id.reporting.numbers import UNKNOWN, show_fixed, show_with_sd
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import Summary
from mocap_id.reporting.tables import Grid, grid, millimetres, percent

_KINDS = ("ball", "two-axis", "hinge")
_AXES = "xyz"


def joints(summary: Summary) -> Grid:
    """Return kinds, centres and arcs of the joints."""
    names = summary.segments.names or []
    rows = []
    for joint in summary.joints or ():
        parent = names[joint.parent] if 0 <= joint.parent < len(names) else str(joint.parent)
        centre = zip(_three(joint.centre_m), _three(joint.sd_m), strict=True)
        shown = [show_with_sd(value, sd) for value, sd in centre] if joint.known else ["not shown by the motion"] * 3
        rows.append((joint.name, joint.kind, parent, *shown, show_fixed(joint.arc_deg, 1)))
    head = ("joint", "kind", "fixed to", *(f"{axis} (m)" for axis in _AXES), "arc (deg)")
    caption = (
        "Joint centres in the frame of the previous segment, ± one standard deviation. A hinge has a centre only "
        "across its axis"
    )
    return grid(caption, head, rows, (0, 1, 2))


def glides(summary: Summary) -> Grid:
    """Return the translations of joint centres with the elevation; empty without any."""
    rows = []
    for joint in summary.joints or ():
        values = zip(joint.glide_m, _three(joint.glide_sd_m), strict=False)
        shown = [show_with_sd(1e3 * value, None if sd is None else 1e3 * sd) for value, sd in values]
        if shown:
            rows.append((joint.name, *shown))
    caption = "Glide: shift of the joint centre at an elevation of 180°, in the frame of the previous segment"
    return grid(caption, ("joint", *(f"{axis} (mm)" for axis in _AXES)), rows)


def _three(values: list[float] | None) -> list[float | None]:
    return [None, None, None] if not values else [*values]


def axes(summary: Summary) -> Grid:
    """Return the axes of hinges and two-axis joints."""
    rows = []
    for joint in summary.joints or ():
        found = joint.axis or []
        listed = found if found and isinstance(found[0], list) else [found] if found else []
        for k, axis in enumerate(listed):
            sd = joint.axis_sd_deg[k] if k < len(joint.axis_sd_deg) else None
            frame = "previous segment" if k == 0 else "own segment"
            parts = [show_fixed(part, 3) for part in axis] if isinstance(axis, list) else []
            rows.append((joint.name, str(k + 1), frame, *parts, show_fixed(sd, 1)))
    head = ("joint", "axis", "in the frame of the", *_AXES, "sd (deg)")
    return grid("Axes of hinges and two-axis joints", head, rows, (0, 2))


def kinds(summary: Summary) -> Grid:
    """Return the evidence for the kind of each joint."""
    rows = [
        (joint.name, joint.kind, *(show_fixed(joint.evidence.get(kind), 2) for kind in _KINDS))
        for joint in summary.joints or ()
        if joint.evidence
    ]
    caption = (
        "Kinds of the joints: rotation that each kind leaves unexplained, as a multiple of the noise of the markers. "
        "The simplest kind with a small multiple is chosen; a ball explains every rotation"
    )
    return grid(caption, ("joint", "kind", *_KINDS), rows, (0, 1))


def angles(summary: Summary) -> Grid:
    """Return range, interval and share of usable samples of each angle."""
    rows = []
    for name, entry in summary.angles.items():
        interval = entry.interval_deg
        ends = UNKNOWN if interval is None else " … ".join(show_fixed(end, 1) for end in interval)
        values = (entry.low_deg, entry.high_deg, entry.range_deg)
        rows.append(
            (
                name.replace("_", " "),
                *(show_fixed(value, 1) for value in values),
                ends,
                show_fixed(entry.sd_deg, 2),
                show_fixed(entry.constant_sd_deg, 1),
                percent(entry.used_share),
            )
        )
    head = (
        *("angle", "lowest (deg)", "highest (deg)", "range (deg)", "95 % interval of the range (deg)"),
        *("sd of changes (deg)", "sd of a constant error (deg)", "samples used (%)"),
    )
    caption = (
        "Angles. Plane and axial rotation of the shoulder are judged only where the elevation is more than 15° from 0 "
        "and 180°. The interval of the range holds both standard deviations"
    )
    return grid(caption, head, rows)


def imus(summary: Summary) -> Grid:
    """Return clock, bias, place and residuals of each inertial sensor."""
    rows = []
    for name, each in summary.imus.items():
        bias = None if each.gyro_bias_rad_s is None else math.degrees(math.hypot(*each.gyro_bias_rad_s))
        clock, sd = (None if value is None else 1e3 * value for value in (each.clock_offset_s, each.sd_s))
        place = ", ".join(millimetres(value) for value in _three(each.position_m))
        used = "yes" if each.used else f"no: {each.why}"
        shown = "yes" if each.observable else "no"
        rows.append(
            (
                *(name.replace("_", " "), used, show_with_sd(clock, sd), shown, show_fixed(each.ppm, 0)),
                *(show_fixed(bias, 2), place, show_fixed(each.mounting_sd_deg, 1), show_fixed(each.skin_share, 2)),
                *(show_fixed(each.gyro_residual_rad_s, 3), show_fixed(each.acc_residual_m_s2, 2)),
            )
        )
    head = (
        *("segment", "used", "clock offset (ms)", "shown by the motion", "clock drift (ppm)", "gyroscope bias (deg/s)"),
        *("place (mm)", "sd of mounting (deg)", "twist that the skin does not follow"),
        *("gyroscope against markers (rad/s)", "accelerometer against markers (m/s²)"),
    )
    caption = "Inertial sensors: clock against the cameras, and what was estimated from the motion"
    return grid(caption, head, rows, (0, 1, 3))


def landmarks(data: ReportData, summary: Summary) -> Grid:
    """Return the landmarks with their uncertainty, and the residual of the marker of the same name."""
    labels = dict(part.split(" ", 1) for part in data.settings.get("landmarks", "").split(", ") if " " in part)
    rows = []
    for name, entry in summary.landmarks.items():
        residual = data.residuals.get(labels.get(name, name))
        rows.append(
            (
                name,
                entry.segment,
                *(millimetres(value) for value in _three(entry.local_m)),
                millimetres(entry.sd_m),
                millimetres(None if residual is None else residual.rms),
            )
        )
    head = ("landmark", "segment", "x (mm)", "y (mm)", "z (mm)", "sd (mm)", "residual of its marker, rms (mm)")
    caption = "Anatomical landmarks in the frames of their segments. The residual is the motion against the chain"
    return grid(caption, head, rows, (0, 1))
