"""Inertial parameters: base parameters (figure 6.8) and point masses (figure 6.9)."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import NORMAL_95, IntArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Figure, Heat, Item, Panel, Points, Rule, Scale, arrange_in_lines
from mocap_id.reporting.report_data import ReportData
from mocap_id.store.views import IdentifiedDynamics

_ROW = 0.24  # inches per parameter


def draw(data: ReportData) -> Figure | str:
    """Return a panel for each unit: dot and 95 % interval of each parameter, and a cross for the reference."""
    dynamics = data.dynamics
    if dynamics is None or not np.isfinite(dynamics.value).any():
        why = data.facts("dynamics.h5").get("why") or data.why_missing("dynamics.h5")
        return f"No base parameters: {style.clean(why)}."
    units = np.array(dynamics.units)
    return Figure(
        tuple((_draw_panel(dynamics, np.flatnonzero(units == unit), unit),) for unit in dict.fromkeys(dynamics.units))
    )


def _draw_panel(dynamics: IdentifiedDynamics, member: IntArray, unit: str) -> Panel:
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
    names = tuple(style.clean(dynamics.names[i], 34) for i in member)
    return Panel(items, x=style.format_unit(unit), rows=names, height=0.55 + _ROW * len(member))


_COLUMNS = 4
_LEAST_MASS = 1e-3  # kg; a point with less mass is drawn as a point without mass


def draw_point_masses(data: ReportData) -> Figure | str:
    """Return a panel for each body, in the frame of the body, with a common colour scale."""
    dynamics = data.dynamics
    if dynamics is None or not np.isfinite(dynamics.grid_mass).any():
        facts = data.facts("dynamics.h5")
        why = facts.get("why") or data.why_missing("dynamics.h5")
        if facts.get("consistency") in ("cone", "bounded-cone"):
            why = (
                "the fit uses the exact cone of physically consistent bodies, which gives mass, first moments and "
                "inertia but no point masses"
            )
        return f"No point masses: {style.clean(why)}."
    names = data.body_names
    panels = tuple(
        _draw_mass_panel(dynamics, k, names[k] if k < len(names) else f"segment {k}")
        for k in np.unique(dynamics.grid_segment)
    )
    scale = Scale(0.0, max(float(np.nanmax(dynamics.grid_mass)), _LEAST_MASS), "mass of a point (kg)")
    return Figure(arrange_in_lines(panels, _COLUMNS), scale)


def _draw_mass_panel(dynamics: IdentifiedDynamics, segment: int, name: str) -> Panel:
    own = dynamics.grid_segment == segment
    (x, y), mass = dynamics.grid_position[own].T, dynamics.grid_mass[own]
    carries, nothing = mass > _LEAST_MASS, np.zeros(1)
    items = (
        Points(x[~carries], y[~carries], style.GRID, size=2.0),
        Points(nothing, nothing, style.INK, symbol="+", size=8.0),
        Heat(x[carries], y[carries], mass[carries]),
    )
    title = f"{style.clean(name, 18)}, {np.nansum(mass):.1f} kg"
    return Panel(items, title, "x in the segment frame (m)", "y (m)", equal=True, height=3.2)
