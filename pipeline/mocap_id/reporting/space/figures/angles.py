"""Angles of every joint in space over time, and their derivatives."""

from __future__ import annotations

from mocap_id.reporting.figure import Figure
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.space.joint_motions import joint_motions


def draw(data: ReportData) -> Figure | str:
    """Draw one panel for each joint."""
    return _panels(data, "angles", (0,), 1.9)


def draw_rates(data: ReportData) -> Figure | str:
    """Draw velocities and accelerations side by side, one line for each joint."""
    return _panels(data, "velocities and accelerations", (1, 2), 1.7)


def _panels(data: ReportData, what: str, derivatives: tuple[int, ...], height: float) -> Figure | str:
    found = joint_motions(data)
    if not found:
        return f"No {what}: {data.why_missing('angles.parquet')}."
    below = ["" for _ in found[1:]] + ["time (s)"]
    rows = zip(found, below, strict=True)
    return Figure(tuple(tuple(one.panel(order, height, below=x) for order in derivatives) for one, x in rows))
