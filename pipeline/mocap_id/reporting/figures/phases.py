"""Wrench, centre of pressure and joint torques over normalised time, averaged over the repetitions."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Band, Dash, Figure, Item, Line, Panel
from mocap_id.reporting.report_data import ReportData
from mocap_id.store import Table

SPAN = "time in the repetition (%)"
_WRENCH = (("Fx", "Fx (N)"), ("Fy", "Fy (N)"), ("tauz", "τz (N·m)"), ("cop_x", "CoP x (m)"))
_COP_TAIL = 0.02
_SOURCES: tuple[tuple[str, str, Dash, str], ...] = (
    ("", style.MEASURED, "-", "measured"),
    ("_model", style.MODEL, "-", "identified model"),
    ("_reference", style.REFERENCE, "--", "allometric reference"),
)


def draw(data: ReportData) -> Figure | str:
    """Draw four panels of the wrench and one of the torques: mean and one standard deviation."""
    table = data.table("phases.parquet")
    if table is None:
        return f"No averages over repetitions: {data.why_missing('phases.parquet')}."
    names = data.skeleton.joints if data.skeleton is not None else ()
    wrench = tuple(_panel(table, name, label) for name, label in _WRENCH)
    torques = tuple(
        item
        for k, name in enumerate(names, start=1)
        for item in _curve(table, f"tau_{k}", style.colour(k), "-", f"{style.printable(name, 14)} torque")
    )
    if not torques and not any(panel.items for panel in wrench):
        why = data.facts("phases.parquet").get("why") or "forces and torques are unknown"
        return f"No averages over repetitions: {style.printable(why)}."
    last = Panel(torques, "joint torques (N·m)", SPAN, x_range=(0, 100), linked=True)
    return Figure((wrench[:2], wrench[2:], *(((last,),) if torques else ())))


def averaged(table: Table, quantity: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, standard deviation and percent of a quantity over complete repetitions; empty if missing."""
    own = (table["quantity"] == quantity) & (table["span"] == "repetition")
    mean, sd, percent = table.stack(["mean", "sd", "percent"])[own].T
    return mean, sd, percent


def _panel(table: Table, name: str, label: str) -> Panel:
    items, curves = [], []
    for suffix, colour, dash, what in _SOURCES:
        items += _curve(table, f"{name}{suffix}", colour, dash, what)
        curves.append(averaged(table, f"{name}{suffix}")[0])
    framed = style.framed(curves, _COP_TAIL if name == "cop_x" else 0.0)
    return Panel(tuple(items), label, SPAN, x_range=(0, 100), y_range=framed, linked=True)


def _curve(table: Table, quantity: str, colour: str, dash: Dash, label: str) -> list[Item]:
    mean, sd, percent = averaged(table, quantity)
    if not np.isfinite(mean).any():
        return []
    return [Band(percent, mean - sd, mean + sd, colour, 0.15), Line(percent, mean, colour, label, dash, 1.2)]
