"""Figures of the dynamics: ground reaction wrench, joint torques, base parameters and point masses."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import NORMAL_95
from mocap_id.reporting import style
from mocap_id.reporting.figure import (
    Band,
    Dash,
    Figure,
    Heat,
    Item,
    Line,
    Panel,
    Points,
    Rule,
    Scale,
    arrange_in_lines,
    thin_band,
    thin_curve,
)
from mocap_id.reporting.figures.motion import draw_shades
from mocap_id.reporting.report_data import ReportData
from mocap_id.store import Table

_ROWS = (("Fx", "Fx (N)"), ("Fy", "Fy, up (N)"), ("tauz", "τz (N·m)"), ("cop_x", "CoP x (m)"))
_ROWS_IN_SPACE = (
    ("Fx", "Fx (N)"), ("Fy", "Fy, up (N)"), ("Fz", "Fz (N)"),
    ("taux", "τx (N·m)"), ("tauy", "τy (N·m)"), ("tauz", "τz (N·m)"),
)  # fmt: skip
_SOURCES: tuple[tuple[str, str, Dash, float, str], ...] = (
    ("", style.MEASURED, "-", 0.9, "measured"),
    ("_reference", style.REFERENCE, "--", 1.1, "allometric reference"),
    ("_model", style.MODEL, "-", 1.1, "identified model"),
)
_COP_TAIL = 0.005  # outliers of the centre of pressure at low load


def draw_wrench(data: ReportData) -> Figure | str:
    """Return a panel over time for each component, with model and reference if the parameters were identified."""
    rows = draw_panels(data, height=1.75)
    if not any(isinstance(item, Line) for row in rows for item in row.items):
        why = data.facts("wrench.parquet").get("why") or data.why_missing("wrench.parquet")
        return f"No ground reaction wrench: {style.clean(why)}."
    return Figure(tuple((row,) for row in rows))


def draw_torques(data: ReportData) -> Figure | str:
    """Return a panel over time with the torque of every joint and its 95 % band; contact is shaded."""
    table, names = data.table("dynamics.parquet"), data.skeleton.joints if data.skeleton is not None else ()
    known = [j for j in range(1, len(names) + 1) if table is not None and np.isfinite(table[f"tau_{j}"]).any()]
    if table is None or not known:
        return (
            f"No joint torques: {style.clean(data.facts('dynamics.h5').get('why') or data.why_missing('dynamics.h5'))}."
        )
    time, words = table["time"], data.facts("dynamics.parquet").get("positive") or {}
    panels = []
    for j in known:
        torque, half = table[f"tau_{j}"], NORMAL_95 * table[f"sd_tau_{j}"]
        colour, name = style.pick_colour(j), style.clean(names[j - 1], 20)
        items: tuple[Item, ...] = (
            *draw_shades(time, data.contact),
            Band(*thin_band(time, torque - half, torque + half), colour),
            Line(*thin_curve(time, torque), colour, name),
        )
        positive = words[names[j - 1]][0] if names[j - 1] in words else ""
        title = f"{name}, positive: {positive}" if positive else name
        below = "time (s)" if j == known[-1] else ""
        panels.append(
            Panel(
                items, title, below, "torque (N·m)", (float(time[0]), float(time[-1])), style.find_range([torque]),
                linked=True, height=1.9,
            )
        )  # fmt: skip
    return Figure(tuple((one,) for one in panels))


def draw_panels(data: ReportData, height: float) -> tuple[Panel, ...]:
    """Return a panel for each component of the wrench; empty without measured forces.

    A panel contains shaded samples of the fit, the model with its band, the reference and the measurement.
    """
    table = read_forces(data)
    rows = _ROWS_IN_SPACE if data.in_space else _ROWS
    if table is None or not {name for name, _ in rows} <= set(table.names):
        return ()
    time, panels = table["time"], []
    ends = (float(time[0]), float(time[-1])) if len(time) else None
    for name, label in rows:
        known = {
            suffix: table[name + suffix]
            for suffix, *_ in _SOURCES
            if name + suffix in table.names and np.isfinite(table[name + suffix]).any()
        }
        items: list[Item] = list(draw_shades(time, table["in_fit"])) if "in_fit" in table.names else []
        if "_model" in known and f"sd_{name}_model" in table.names:
            half = NORMAL_95 * table[f"sd_{name}_model"]
            items.append(Band(*thin_band(time, known["_model"] - half, known["_model"] + half), style.MODEL))
        for suffix, colour, dash, width, what in _SOURCES:
            if suffix in known:
                items.append(Line(*thin_curve(time, known[suffix]), colour, what, dash, width))
        framed = style.find_range(list(known.values()), _COP_TAIL if name == "cop_x" else 0.0)
        below, tall = ("time (s)", height + 0.3) if name == rows[-1][0] else ("", height + 0.0)
        panels.append(Panel(tuple(items), x=below, y=label, x_range=ends, y_range=framed, linked=True, height=tall))
    return tuple(panels)


def read_forces(data: ReportData) -> Table | None:
    """Return the table of measured and modelled wrench, else of the measured wrench alone; None without both."""
    found = data.table("dynamics.parquet")
    return data.table("wrench.parquet") if found is None else found


_ROW = 0.24  # inches per parameter


def draw_parameters(data: ReportData) -> Figure | str:
    """Return a panel for each unit: dot and 95 % interval of each parameter, and a cross for the reference."""
    dynamics = data.dynamics
    if dynamics is None or not np.isfinite(dynamics.value).any():
        why = data.facts("dynamics.h5").get("why") or data.why_missing("dynamics.h5")
        return f"No base parameters: {style.clean(why)}."
    units, panels = np.array(dynamics.units), []
    for unit in dict.fromkeys(dynamics.units):
        member = np.flatnonzero(units == unit)
        rows = np.arange(len(member), dtype=np.float64)
        half = NORMAL_95 * np.where(np.isfinite(dynamics.sd[member]), dynamics.sd[member], 0.0)
        reference = dynamics.base_reference[member]
        known = np.isfinite(reference)
        items: list[Item] = [
            Rule("x", 0.0, style.INK),
            Points(dynamics.value[member], rows, style.MODEL, "identified, 95 % interval", half=half),
        ]
        if known.any():
            items.append(Points(reference[known], rows[known], style.REFERENCE, "allometric reference", "x", 6.0))
        names, height = tuple(style.clean(dynamics.names[i], 34) for i in member), 0.55 + _ROW * len(member)
        panels.append(Panel(tuple(items), x=style.format_unit(unit), rows=names, height=height))
    return Figure(tuple((panel,) for panel in panels))


_SEGMENT_COLUMNS = 4
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
    # for the pinned chain, the bodies are the segments
    bodies = data.facts("dynamics.h5")["motion"].get("bodies") or () if data.measured_poses else data.segment_names
    names, panels = tuple(map(str, bodies)), []
    for k in np.unique(dynamics.grid_segment):
        own = dynamics.grid_segment == k
        (x, y), mass = dynamics.grid_position[own].T, dynamics.grid_mass[own]
        carries, nothing = mass > _LEAST_MASS, np.zeros(1)
        items = (
            Points(x[~carries], y[~carries], style.GRID, size=2.0),
            Points(nothing, nothing, style.INK, symbol="+", size=8.0),
            Heat(x[carries], y[carries], mass[carries]),
        )
        name = names[k] if k < len(names) else f"segment {k}"
        title = f"{style.clean(name, 18)}, {np.nansum(mass):.1f} kg"
        panels.append(Panel(items, title, "x in the segment frame (m)", "y (m)", equal=True, height=3.2))
    scale = Scale(0.0, max(float(np.nanmax(dynamics.grid_mass)), _LEAST_MASS), "mass of a point (kg)")
    return Figure(arrange_in_lines(tuple(panels), _SEGMENT_COLUMNS), scale)
