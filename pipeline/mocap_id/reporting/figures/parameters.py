"""Base parameters with their intervals and the allometric reference (figure 6.8)."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import NORMAL_95, IntArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Figure, Item, Panel, Points, Rule
from mocap_id.reporting.report_data import ReportData
from mocap_id.store.views import IdentifiedDynamics

_ROW = 0.24  # inches per parameter


def draw(data: ReportData) -> Figure | str:
    """Draw one panel per unit: dot and 95 % interval for each parameter, and a cross for the reference."""
    dynamics = data.dynamics
    if dynamics is None or not np.isfinite(dynamics.value).any():
        why = data.facts("dynamics.h5").get("why") or data.why_missing("dynamics.h5")
        return f"No base parameters: {style.printable(why)}."
    units = np.array(dynamics.units)
    return Figure(
        tuple((_panel(dynamics, np.flatnonzero(units == unit), unit),) for unit in dict.fromkeys(dynamics.units))
    )


def _panel(dynamics: IdentifiedDynamics, member: IntArray, unit: str) -> Panel:
    rows = np.arange(len(member), dtype=np.float64)
    half = NORMAL_95 * np.where(np.isfinite(dynamics.sd[member]), dynamics.sd[member], 0.0)
    value, reference = dynamics.value[member], dynamics.base_reference[member]
    known = np.isfinite(reference)
    items: tuple[Item, ...] = (
        Rule("x", 0.0, style.INK),
        Points(value, rows, style.MODEL, "identified, 95 % interval", half=half),
        *(
            [Points(reference[known], rows[known], style.REFERENCE, "allometric reference", "x", 6.0)]
            if known.any()
            else []
        ),
    )
    names = tuple(style.printable(dynamics.names[i], 34) for i in member)
    return Panel(items, x=style.unit(unit), rows=names, height=0.55 + _ROW * len(member))
