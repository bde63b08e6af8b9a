"""Tables of the report about joints, angles, sensors and landmarks in space."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from mocap_id.reporting.grids import (
    Grid,
    GridColumn,
    get_element,
    millimetres,
    number,
    percent,
    show_ends,
    text,
    to_grid,
    with_sd,
)
from mocap_id.reporting.numbers import show_millimetres
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.space.schema import ImuEntry
from mocap_id.reporting.summary_schema import Summary

_KINDS = ("ball", "two-axis", "hinge")
_AXES = "xyz"


def to_words(entries: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries with underscores in their keys replaced by blanks."""
    return {name.replace("_", " "): entry for name, entry in entries.items()}


def list_glides(summary: Summary) -> Grid:
    """Return a table of the shifts of joint centres that depend on the elevation; empty if no joint has one."""
    shifts = (
        with_sd(f"{axis} (mm)", get_element("glide_m", k), get_element("glide_sd_m", k), 1e3)
        for k, axis in enumerate(_AXES)
    )
    caption = "Glide: shift of the joint centre at an elevation of 180°, in the frame of the previous segment"
    rows = [joint for joint in summary.joints or () if joint.glide_m]
    return to_grid(caption, rows, (text("joint", "name"), *shifts))


def list_axes(summary: Summary) -> Grid:
    """Return a table of the axes of hinges and two-axis joints."""
    rows = []
    for joint in summary.joints or ():
        listed = joint.axis if joint.axis and isinstance(joint.axis[0], list) else [joint.axis] if joint.axis else []
        sds = [*joint.axis_sd_deg, None, None]
        rows += [(joint.name, k, axis, sds[k]) for k, axis in enumerate(listed)]
    columns = (
        text("joint", lambda row: row[0]),
        GridColumn("axis", lambda row: str(row[1] + 1)),
        text("in the frame of the", lambda row: "own segment" if row[1] else "previous segment"),
        *(number(axis, get_element(lambda row: row[2], d), 3) for d, axis in enumerate(_AXES)),
        number("sd (deg)", lambda row: row[3], 1),
    )
    return to_grid("Axes of hinges and two-axis joints", rows, columns)


def list_kinds(summary: Summary) -> Grid:
    """Return a table of the evidence for the kind (ball, two-axis, hinge) of each joint."""
    columns = (
        text("joint", "name"),
        text("kind", "kind"),
        *(number(kind, get_element("evidence", kind), 2) for kind in _KINDS),
    )
    caption = (
        "Kinds of the joints: rotation that each kind leaves unexplained, as a multiple of the noise of the markers. "
        "The simplest kind with a small multiple is chosen; a ball joint explains every rotation"
    )
    return to_grid(caption, [joint for joint in summary.joints or () if joint.evidence], columns)


def list_angles(summary: Summary) -> Grid:
    """Return a table of each angle: range, interval, standard deviations, and percentage of usable samples."""
    columns = (
        number("lowest (deg)", "low_deg", 1),
        number("highest (deg)", "high_deg", 1),
        number("range (deg)", "range_deg", 1),
        GridColumn("95 % interval of the range (deg)", lambda entry: show_ends(entry.interval_deg, 1)),
        number("sd of changes (deg)", "sd_deg", 2),
        number("sd of a constant error (deg)", "constant_sd_deg", 1),
        percent("samples used (%)", "used_share"),
    )
    caption = (
        "Angles. Plane and axial rotation of the shoulder are evaluated only where the elevation is more than 15° from "
        "0 and 180°. The interval of the range contains both standard deviations"
    )
    return to_grid(caption, to_words(summary.angles), columns, "angle")


def list_imus(summary: Summary) -> Grid:
    """Return a table of clock, bias, position and residuals of each inertial sensor."""

    def bias(entry: ImuEntry) -> float | None:
        return None if entry.gyro_bias_rad_s is None else math.degrees(math.hypot(*entry.gyro_bias_rad_s))

    columns = (
        text("used", lambda entry: "yes" if entry.used else f"no: {entry.why}"),
        with_sd("clock offset (ms)", "clock_offset_s", "sd_s", 1e3),
        text("determined by the motion", lambda entry: "yes" if entry.observable else "no"),
        number("clock drift (ppm)", "ppm", 0),
        number("gyroscope bias (deg/s)", bias, 2),
        GridColumn("position (mm)", lambda entry: ", ".join(map(show_millimetres, entry.position_m or [None] * 3))),
        number("sd of mounting (deg)", "mounting_sd_deg", 1),
        number("fraction of axial rotation that the skin does not follow", "skin_share", 2),
        number("gyroscope against markers (rad/s)", "gyro_residual_rad_s", 3),
        number("accelerometer against markers (m/s²)", "acc_residual_m_s2", 2),
    )
    caption = "Inertial sensors: clock relative to the cameras, and other quantities estimated from the motion"
    return to_grid(caption, to_words(summary.imus), columns, "segment")


def list_landmarks(data: ReportData, summary: Summary) -> Grid:
    """Return a table of the landmarks with their standard deviations, and the residuals of their markers."""
    labels = dict(part.split(" ", 1) for part in data.settings.get("landmarks", "").split(", ") if " " in part)
    residuals = {name: data.residuals.get(labels.get(name, name)) for name in summary.landmarks}
    columns = (
        text("landmark", lambda row: row[0]),
        text("segment", lambda row: row[1].segment),
        *(millimetres(f"{axis} (mm)", get_element(lambda row: row[1].local_m, d)) for d, axis in enumerate(_AXES)),
        millimetres("sd (mm)", lambda row: row[1].sd_m),
        millimetres("residual of its marker, rms (mm)", lambda row: getattr(residuals[row[0]], "rms", None)),
    )
    caption = "Anatomical landmarks in the frames of their segments. The residual is the rms distance from the chain"
    return to_grid(caption, list(summary.landmarks.items()), columns)
