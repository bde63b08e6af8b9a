"""Angles of every joint in space over time, and their derivatives."""

from __future__ import annotations

from mocap_id.reporting.figure import Figure
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.space.joint_motions import joint_motions


def draw(data: ReportData) -> Figure | str:
    """Draw one panel for each joint."""
    found = joint_motions(data)
    if not found:
        return f"No angles: {data.why_missing('angles.parquet')}."
    below = ["" for _ in found[1:]] + ["time (s)"]
    return Figure(tuple((one.panel(0, 1.9, below=x),) for one, x in zip(found, below, strict=True)))


def draw_rates(data: ReportData) -> Figure | str:
    """Draw velocities and accelerations side by side, one line for each joint."""
    found = joint_motions(data)
    if not found:
        return f"No velocities and accelerations: {data.why_missing('angles.parquet')}."
    below = ["" for _ in found[1:]] + ["time (s)"]
    return Figure(
        tuple((one.panel(1, 1.7, below=x), one.panel(2, 1.7, below=x)) for one, x in zip(found, below, strict=True))
    )
