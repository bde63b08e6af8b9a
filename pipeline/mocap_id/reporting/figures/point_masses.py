"""The grid of point masses of each segment as a heat map (figure 6.9)."""

from __future__ import annotations

import numpy as np

from mocap_id.reporting import style
from mocap_id.reporting.figure import Figure, Heat, Panel, Points, Scale, in_lines
from mocap_id.reporting.report_data import ReportData
from mocap_id.store.views import IdentifiedDynamics

_COLUMNS = 4
_LEAST_MASS = 1e-3  # kg; points below this are drawn as empty


def draw(data: ReportData) -> Figure | str:
    """Draw one panel per body in its own frame, with a common colour scale."""
    dynamics = data.dynamics
    if dynamics is None or not np.isfinite(dynamics.grid_mass).any():
        facts = data.facts("dynamics.h5")
        why = facts.get("why") or data.why_missing("dynamics.h5")
        if facts.get("consistency") in ("cone", "bounded-cone"):
            why = (
                "the fit uses the exact cone of physically consistent bodies, which gives mass, first moments and "
                "inertia but no point masses"
            )
        return f"No point masses: {style.printable(why)}."
    names = data.body_names
    panels = tuple(
        _panel(dynamics, k, names[k] if k < len(names) else f"segment {k}") for k in np.unique(dynamics.grid_segment)
    )
    scale = Scale(0.0, max(float(np.nanmax(dynamics.grid_mass)), _LEAST_MASS), "mass of a point (kg)")
    return Figure(in_lines(panels, _COLUMNS), scale)


def _panel(dynamics: IdentifiedDynamics, segment: int, name: str) -> Panel:
    own = dynamics.grid_segment == segment
    (x, y), mass = dynamics.grid_position[own].T, dynamics.grid_mass[own]
    carries, nothing = mass > _LEAST_MASS, np.zeros(1)
    items = (
        Points(x[~carries], y[~carries], style.GRID, size=2.0),
        Points(nothing, nothing, style.INK, symbol="+", size=8.0),
        Heat(x[carries], y[carries], mass[carries]),
    )
    title = f"{style.printable(name, 18)}, {np.nansum(mass):.1f} kg"
    return Panel(items, title, "x in the segment frame (m)", "y (m)", equal=True, height=3.2)
