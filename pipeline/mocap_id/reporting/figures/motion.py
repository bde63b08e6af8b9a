"""Figures of the motion: joint states, angles in space, and averages over the repetitions (figures 6.2, 6.3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import NORMAL_95, BoolArray, FloatArray
from mocap_id.geometry.so3 import shift_to_shortest_arc
from mocap_id.reporting import style
from mocap_id.reporting.figure import (
    Band,
    Bars,
    Dash,
    Figure,
    Heat,
    Item,
    Line,
    Panel,
    Points,
    Rule,
    Scale,
    Spans,
    Text,
    arrange_in_lines,
    find_shaded_spans,
    thin_band,
    thin_curve,
)
from mocap_id.reporting.report_data import ReportData
from mocap_id.store import Table
from mocap_id.store.artefacts import MEANINGLESS_AT_POLE, JointStates

_RATES = ("velocity (deg/s)", "acceleration (deg/s²)")
_STRIP = 0.16  # inches per joint in the panel of gaps


def draw_states(data: ReportData) -> Figure | str:
    """Return angle, velocity and acceleration of all joints, and the intervals in which each joint is bridged."""
    motion = data.shown_motion
    if motion is None or not motion.mean.size:
        return f"No joint states: {data.why_missing('states.parquet')}."
    names = label_joints(data)
    curves = [draw_panel(motion, order, names, height=1.9, label=label_angle(data)) for order in range(3)]
    # a panel with one row per joint, marked where the joint is bridged
    gaps = [find_shaded_spans(motion.time, ~seen) for seen in motion.observed.T]
    found = [(j, start, start + wide) for j, own in enumerate(gaps) for start, wide in own]
    row, low, high = np.array(found, dtype=np.float64).reshape(-1, 3).T
    ends = (float(motion.time[0]), float(motion.time[-1]))
    note = () if found else (Text(sum(ends) / 2, (len(names) - 1) / 2, "none"),)
    bars = Bars(row, low, high, tuple(style.pick_colour(j + 1) for j, *_ in found), thick=0.6)
    rows, height = tuple(style.clean(name, 9) for name in names), 0.65 + _STRIP * len(names)
    strips = Panel((bars, *note), "bridged intervals", "time (s)", x_range=ends, rows=rows, linked=True, height=height)
    return Figure(tuple((one,) for one in (*curves, strips)))


def label_joints(data: ReportData) -> tuple[str, ...]:
    """Return a label for each joint in the states; "joint 1" and so on if it has no name."""
    names = data.joint_names
    count = 0 if data.motion is None else data.motion.mean.shape[1]
    return tuple(style.clean(names[j], 20) if j < len(names) else f"joint {j + 1}" for j in range(count))


def label_angle(data: ReportData) -> str:
    """Return the label of an axis with joint angles, which says where they are zero."""
    where = {"static": ", static pose", "standing": " from standing", "segment line": ", segment line"}
    sources = {source for source, *_ in data.zeros}
    return f"angle{where.get(sources.pop(), '') if len(sources) == 1 else ''} (deg)"


def draw_panel(
    motion: JointStates, order: int, names: tuple[str, ...], height: float, label: str = "angle (deg)"
) -> Panel:
    """Return a panel with the derivative ``order`` (0 to 2) of all joint angles, in degrees, with 95 % bands.

    ``label`` is the label of the axis of angles. Bridged intervals are shaded; their bands do not affect the range of
    the axis.
    """
    bands, lines, framed = [], [], []
    for j, name in enumerate(names):
        value = np.degrees(motion.mean[:, j, order])
        half = NORMAL_95 * np.degrees(motion.sd[:, j, order])
        colour, seen = style.pick_colour(j + 1), motion.observed[:, j]
        bands.append(Band(*thin_band(motion.time, value - half, value + half), colour))
        lines.append(Line(*thin_curve(motion.time, value), colour, name, style.pick_dash(j + 1)))
        framed += [value, (value - half)[seen], (value + half)[seen]]
    gaps = draw_shades(motion.time, motion.observed.sum(axis=1) < motion.observed.shape[1])
    items: tuple[Item, ...] = (*gaps, *bands, *lines)
    ends = (float(motion.time[0]), float(motion.time[-1]))
    quantity = (label, *_RATES)[order]
    return Panel(items, y=quantity, x_range=ends, y_range=style.find_range(framed), linked=True, height=height)


def draw_shades(time: FloatArray, mask: BoolArray, colour: str = style.GRID, **look: float) -> tuple[Spans, ...]:
    """Return shaded intervals where ``mask`` (T,) is true; empty if it is true nowhere."""
    found = np.array(find_shaded_spans(time, mask)).reshape(-1, 2)
    return (Spans(found[:, 0], found.sum(axis=1), colour, **look),) if len(found) else ()


_SPAN = "time in the repetition (%)"
_WRENCH = (("Fx", "Fx (N)"), ("Fy", "Fy (N)"), ("tauz", "τz (N·m)"), ("cop_x", "CoP x (m)"))
_COP_PHASE_TAIL = 0.02
_PHASE_SOURCES: tuple[tuple[str, str, Dash, str], ...] = (
    ("", style.MEASURED, "-", "measured"),
    ("_model", style.MODEL, "-", "identified model"),
    ("_reference", style.REFERENCE, "--", "allometric reference"),
)
_COLUMNS = 3
_GRID = np.linspace(0.0, 1.0, 101)


def draw_repetitions(data: ReportData) -> Figure | str:
    """Return a panel for each joint: repetitions (thin), mean (thick) and one standard deviation (band)."""
    motion, events, averages = data.shown_motion, data.table("events.parquet"), data.table("phases.parquet")
    bounds = np.zeros((0, 2)) if events is None else events.stack(["start", "end"])
    bounds = bounds[bounds[:, 1] > bounds[:, 0]]  # false if start or end is NaN
    if motion is None or events is None or not motion.mean.size or not len(bounds):
        why = "none were found" if events is not None else data.why_missing("events.parquet")
        return f"No repetitions to compare: {why}."
    normalised = np.degrees(normalise_time(motion, bounds))  # (R, 101, n)
    start, seat_off, end = events.stack(["start", "seat_off", "end"]).T
    share = (seat_off - start) / np.where(end > start, end - start, np.nan)
    share = share[np.isfinite(share)]
    percent, panels = 100 * _GRID, []
    for j, name in enumerate(label_joints(data)):
        # all repetitions as one interrupted line, their mean, and one standard deviation
        curves, colour = normalised[..., j], style.pick_colour(j + 1)
        count = np.isfinite(curves).sum(axis=0)
        mean = np.nansum(curves, axis=0) / np.where(count > 0, count, np.nan)
        spread = np.sqrt(np.nansum((curves - mean) ** 2, axis=0) / np.where(count > 1, count - 1, np.nan))
        lifted = np.pad(curves, ((0, 0), (0, 1)), constant_values=np.nan)
        items: list[Item] = [
            Line(np.tile([*percent, np.nan], len(curves)), lifted.ravel(), colour, width=0.6, opacity=0.6),
            Band(percent, mean - spread, mean + spread, colour, 0.2),
            Line(percent, mean, colour, width=1.8),
        ]
        if averages is not None:  # the same angle from another system
            mean, sd, at = read_average(averages, f"theta_{j + 1}_other")
            if np.isfinite(mean).any():
                mean, sd = np.degrees(mean), np.degrees(sd)
                items.append(Band(at, mean - sd, mean + sd, style.OTHER, 0.2))
                items.append(Line(at, mean, style.OTHER, "another system", "--", 1.4))
        if len(share):
            items.append(Rule("x", 100 * float(share.mean()), style.INK, ":", 0.8))
        panels.append(Panel(tuple(items), name, _SPAN, label_angle(data), x_range=(0, 100), linked=True, height=2.4))
    return Figure(arrange_in_lines(tuple(panels), _COLUMNS))


def normalise_time(motion: JointStates, bounds: FloatArray) -> FloatArray:
    """Return the angles at 0, 1 … 100 % of each repetition, (R, 101, n), rad; NaN where bridged or unknown."""
    at = bounds[:, :1] + (bounds[:, 1:] - bounds[:, :1]) * _GRID  # (R, 101)
    nearest = np.searchsorted(motion.time, at).clip(0, len(motion.time) - 1)
    curves = np.stack([np.interp(at, motion.time, angle, np.nan, np.nan) for angle in motion.angles.T], axis=-1)
    return np.where(motion.observed[nearest], curves, np.nan)


def draw_phases(data: ReportData) -> Figure | str:
    """Return four panels of the wrench and one of the torques, each with mean and one standard deviation."""
    table = data.table("phases.parquet")
    if table is None:
        return f"No averages over repetitions: {data.why_missing('phases.parquet')}."
    names, wrench = data.joint_names, []
    for name, label in _WRENCH:
        items, curves = [], []
        for suffix, colour, dash, what in _PHASE_SOURCES:
            items += _draw_average(table, f"{name}{suffix}", colour, dash, what)
            curves.append(read_average(table, f"{name}{suffix}")[0])
        framed = style.find_range(curves, _COP_PHASE_TAIL if name == "cop_x" else 0.0)
        wrench.append(Panel(tuple(items), label, _SPAN, x_range=(0, 100), y_range=framed, linked=True))
    torques = [
        item
        for k, name in enumerate(names, start=1)
        for item in _draw_average(table, f"tau_{k}", style.pick_colour(k), "-", f"{style.clean(name, 14)} torque")
    ]
    if not torques and not any(panel.items for panel in wrench):
        why = data.facts("phases.parquet").get("why") or "forces and torques are unknown"
        return f"No averages over repetitions: {style.clean(why)}."
    legs = ", both legs together" if data.facts("dynamics.parquet").get("legs") == "both" else ""
    # shaded: fewer repetitions than elsewhere have a torque
    unknown = np.zeros(len(_GRID), dtype=np.bool_)
    for k in range(1, len(names) + 1):
        own = (table["quantity"] == f"tau_{k}") & (table["span"] == "repetition")
        if own.any():
            unknown |= table["count"][own] < table["count"][own].max()
    shades = draw_shades(100 * _GRID, unknown)
    last = Panel((*shades, *torques), f"joint torques{legs} (N·m)", _SPAN, x_range=(0, 100), linked=True)
    return Figure((tuple(wrench[:2]), tuple(wrench[2:]), *(((last,),) if torques else ())))


def read_average(table: Table, quantity: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, standard deviation and percent of a quantity over complete repetitions; empty if missing."""
    own = (table["quantity"] == quantity) & (table["span"] == "repetition")
    mean, sd, percent = table.stack(["mean", "sd", "percent"])[own].T
    return mean, sd, percent


def _draw_average(table: Table, quantity: str, colour: str, dash: Dash, label: str) -> list[Item]:
    mean, sd, percent = read_average(table, quantity)
    if not np.isfinite(mean).any():
        return []
    return [Band(percent, mean - sd, mean + sd, colour, 0.15), Line(percent, mean, colour, label, dash, 1.2)]


_ANATOMICAL = {"upper_arm": "shoulder", "forearm": "elbow", "hand": "wrist"}
"""Names of the angles of the joints that move these segments."""


def collect_joint_curves(data: ReportData) -> list[tuple[str, tuple[str, ...], JointStates, BoolArray]]:
    """Return the angles of each joint, and at the end any other angles; empty if nothing was estimated.

    An entry has the title, the names of the angles, their states, NaN where an angle has no meaning, and the samples
    (T,) in which some of the angles have no meaning.
    """
    angles, poses, skeleton = data.angles, data.segment_poses, data.spatial_skeleton
    if angles is None or not angles.names or not len(angles.time):
        return []
    seen = np.ones(len(angles.time), dtype=np.bool_)
    members, left = [], list(angles.names)  # joint, its angles, samples in which both its segments are observed
    if skeleton is not None:
        for j, joint in enumerate(skeleton.joints):
            stems = (f"{_ANATOMICAL.get(skeleton.segments[j + 1], joint)}_", f"joint_{j + 1}_")
            own = [name for name in left if name.startswith(stems)]
            left = [name for name in left if name not in own]
            observed: BoolArray = seen
            if poses is not None and len(poses.time) == len(angles.time):
                observed = np.asarray(poses.observed[:, [skeleton.chain.parents[j], j + 1]].all(axis=1))
            members.append((joint, own, observed))
    found = []
    for joint, own, observed in (*members, ("other angles", left, seen)):
        if not own:
            continue
        columns = [angles.names.index(name) for name in own]
        mean = angles.mean[:, columns].copy()
        for k, name in enumerate(own):
            usable = angles.find_usable(name)
            if name in MEANINGLESS_AT_POLE and usable.any():
                mean[usable, k, 0] = shift_to_shortest_arc(mean[usable, k, 0])
            mean[~usable, k] = np.nan
        states = JointStates(angles.time, mean, angles.sd[:, columns], np.tile(observed[:, None], (1, len(own))))
        near = angles.near_gimbal & any(name in MEANINGLESS_AT_POLE for name in own)
        names = tuple(style.clean(name.replace("_", " "), 24) for name in own)
        found.append((style.clean(joint.replace("_", " "), 24), names, states, near))
    return found


def draw_joint_panels(data: ReportData, orders: tuple[int, ...], height: float) -> list[tuple[Panel, ...]]:
    """Return a line of panels for each joint: its angles, velocities or accelerations over time (order 0, 1 or 2)."""
    lines = []
    for title, names, states, near in collect_joint_curves(data):
        shade = draw_shades(states.time, near, style.SKY, opacity=0.25)
        drawn = [draw_panel(states, order, names, height) for order in orders]
        lines.append(tuple(replace(panel, items=(*shade, *panel.items), title=title) for panel in drawn))
    return lines


def draw_derivatives(data: ReportData, what: str, orders: tuple[int, ...], height: float) -> Figure | str:
    """Return angles, or velocities and accelerations side by side, one line of panels for each joint."""
    lines = draw_joint_panels(data, orders, height)
    if not lines:
        return f"No {what}: {data.why_missing('angles.parquet')}."
    lines[-1] = tuple(replace(panel, x="time (s)") for panel in lines[-1])
    return Figure(tuple(lines))


_PORTRAITS = ("elbow_flexion", "shoulder_elevation", "shoulder_plane", "shoulder_axial")
_COLOURS = (style.BLUE, style.GREEN, style.VERMILLION)  # first, middle and last third of the curls
_HEIGHT = 2.4


def draw_phase_portraits(data: ReportData) -> Figure | str:
    """Return phase portraits of all complete curls, with a 95 % band of the acceleration for the first and the last."""
    angles, table = data.angles, data.table("events.parquet")
    if angles is None or table is None or "amplitude" not in table.names:
        return "No phase portraits: only `protocol: curl` has them."
    turns = table.stack(["start", "top", "end"])[table["complete"].astype(bool)]
    names = [name for name in _PORTRAITS if name in angles.names]
    if not len(turns) or not names:
        return "No phase portraits: no complete curl was found."
    panels = []
    for name in names:
        items: list[Item] = []
        j = angles.names.index(name)
        for k, (start, top, end) in enumerate(turns):
            colour = _COLOURS[len(_COLOURS) * k // len(turns)]
            halves = [(angles.time >= a) & (angles.time <= b) for a, b in ((start, top), (top, end))]
            for within in halves if k in {0, len(turns) - 1} else ():
                mean, half = angles.mean[within, j], NORMAL_95 * angles.sd[within, j, 2]
                order = np.argsort(mean[:, 0], kind="stable")
                low, high = (mean[:, 2] - half)[order], (mean[:, 2] + half)[order]
                items.append(Band(np.degrees(mean[order, 0]), low, high, colour, 0.15))
            mean = angles.mean[halves[0] | halves[1], j]
            items.append(Line(np.degrees(mean[:, 0]), mean[:, 2], colour, width=0.8, opacity=0.7))
        title = style.clean(name.replace("_", " "), 24)
        panels.append(Panel(tuple(items), title, "angle (deg)", "acceleration (rad/s²)", height=_HEIGHT))
    return Figure(arrange_in_lines(tuple(panels), 2))


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
        return f"No ground reaction wrench: {style.clean(data.explain('wrench.parquet'))}."
    return Figure(tuple((row,) for row in rows))


def draw_torques(data: ReportData) -> Figure | str:
    """Return a panel over time with the torque of every joint and its 95 % band; contact is shaded."""
    table, names = data.table("dynamics.parquet"), data.joint_names
    known = [j for j in range(1, len(names) + 1) if table is not None and np.isfinite(table[f"tau_{j}"]).any()]
    if table is None or not known:
        return f"No joint torques: {style.clean(data.explain('dynamics.h5'))}."
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
        return f"No base parameters: {style.clean(data.explain('dynamics.h5'))}."
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
        why = data.explain("dynamics.h5")
        if data.facts("dynamics.h5").get("consistency") in ("cone", "bounded-cone"):
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
