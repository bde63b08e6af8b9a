"""Joint states over time with confidence bands and shaded gaps (figure 6.2, right)."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import NORMAL_95, BoolArray, FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.downsampling import find_spans, thin_band, thin_curve
from mocap_id.reporting.figure import Band, Bars, Figure, Item, Line, Panel, Spans, Text
from mocap_id.reporting.report_data import ReportData
from mocap_id.store.views import JointStates

_RATES = ("velocity (deg/s)", "acceleration (deg/s²)")
_STRIP = 0.16  # inches per joint in the panel of gaps


def draw(data: ReportData) -> Figure | str:
    """Return angle, velocity and acceleration of all joints, and the intervals in which each joint is bridged."""
    motion = data.shown_motion
    if motion is None or not motion.mean.size:
        return f"No joint states: {data.why_missing('states.parquet')}."
    names = name_joints(data)
    curves = [draw_panel(motion, order, names, height=1.9, label=label_angle(data)) for order in range(3)]
    return Figure(tuple((one,) for one in (*curves, _draw_strips(motion, names))))


def name_joints(data: ReportData) -> tuple[str, ...]:
    """Return a label for each joint in the states; "joint 1" and so on if it has no name."""
    names = data.skeleton.joints if data.skeleton is not None else ()
    count = 0 if data.motion is None else data.motion.mean.shape[1]
    return tuple(style.clean(names[j], 20) if j < len(names) else f"joint {j + 1}" for j in range(count))


def label_angle(data: ReportData) -> str:
    """Return the label of an axis with joint angles, which says where they are zero."""
    sources = {zero.source for zero in data.zeros}
    where = {
        frozenset({"static"}): ", static pose",
        frozenset({"standing"}): " from standing",
        frozenset({"segment line"}): ", segment line",
    }
    return f"angle{where.get(frozenset(sources), '')} (deg)"


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
    ends = _find_ends(motion)
    quantity = (label, *_RATES)[order]
    return Panel(items, y=quantity, x_range=ends, y_range=style.find_range(framed), linked=True, height=height)


def draw_shades(time: FloatArray, mask: BoolArray) -> tuple[Spans, ...]:
    """Return shaded intervals where ``mask`` (T,) is true; empty if it is true nowhere."""
    found = np.array(find_spans(time, mask)).reshape(-1, 2)
    return (Spans(found[:, 0], found.sum(axis=1), style.GRID),) if len(found) else ()


def _draw_strips(motion: JointStates, names: tuple[str, ...]) -> Panel:
    """Return a panel with one row per joint, marked where the joint is bridged."""
    gaps = [find_spans(motion.time, ~seen) for seen in motion.observed.T]
    found = [(j, start, start + wide) for j, own in enumerate(gaps) for start, wide in own]
    row, low, high = np.array(found, dtype=np.float64).reshape(-1, 3).T
    ends = _find_ends(motion)
    note = () if found else (Text(sum(ends) / 2, (len(names) - 1) / 2, "none"),)
    bars = Bars(row, low, high, tuple(style.pick_colour(j + 1) for j, *_ in found), thick=0.6)
    rows = tuple(style.clean(name, 9) for name in names)
    height = 0.65 + _STRIP * len(names)
    return Panel((bars, *note), "bridged intervals", "time (s)", x_range=ends, rows=rows, linked=True, height=height)


def _find_ends(motion: JointStates) -> tuple[float, float]:
    return float(motion.time[0]), float(motion.time[-1])
