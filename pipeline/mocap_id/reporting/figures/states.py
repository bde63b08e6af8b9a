"""Joint states over time, with bands, and shades where nothing was seen (figure 6.2, right)."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.decimation import band, envelope, spans
from mocap_id.reporting.figure import Band, Bars, Figure, Item, Line, Panel, Spans, Text
from mocap_id.reporting.material import Material
from mocap_id.reporting.numbers import NORMAL_95
from mocap_id.reporting.views import Motion

_QUANTITIES = ("angle (deg)", "velocity (deg/s)", "acceleration (deg/s²)")
_STRIP = 0.16  # inches for each joint's strip of gaps


def shown(material: Material) -> Figure | str:
    """Angle, velocity and acceleration of every joint, and below them which joint is bridged when."""
    motion = material.motion
    if motion is None or not motion.mean.size:
        return f"No joint states: {material.why_missing('states.parquet')}."
    names = joint_names(material)
    curves = [panel(motion, order, names, height=1.9) for order in range(3)]
    return Figure(tuple((one,) for one in (*curves, _strips(motion, names))))


def joint_names(material: Material) -> tuple[str, ...]:
    """What every joint of the states goes by."""
    names = material.skeleton.joints if material.skeleton is not None else ()
    count = 0 if material.motion is None else material.motion.mean.shape[1]
    return tuple(style.printable(names[j], 20) if j < len(names) else f"joint {j + 1}" for j in range(count))


def panel(motion: Motion, order: int, names: tuple[str, ...], height: float) -> Panel:
    """One derivative of every joint, degrees, with its 95 % band; framed by what was observed, not by the gaps."""
    bands, lines, framed = [], [], []
    for j, name in enumerate(names):
        value = np.degrees(motion.mean[:, j, order])
        half = NORMAL_95 * np.degrees(motion.sd[:, j, order])
        colour, seen = style.colour(j + 1), motion.observed[:, j]
        bands.append(Band(*band(motion.time, value - half, value + half), colour))
        lines.append(Line(*envelope(motion.time, value), colour, name, style.dashes(j + 1)))
        framed += [value, (value - half)[seen], (value + half)[seen]]
    gaps = shades(motion.time, motion.observed.sum(axis=1) < motion.observed.shape[1])
    items: tuple[Item, ...] = (*gaps, *bands, *lines)
    ends = _ends(motion)
    return Panel(items, y=_QUANTITIES[order], x_range=ends, y_range=style.framed(framed), linked=True, height=height)


def shades(time: FloatArray, mask: BoolArray) -> tuple[Spans, ...]:
    """Where the mask (T,) holds; nothing where it never does."""
    found = np.array(spans(time, mask)).reshape(-1, 2)
    return (Spans(found[:, 0], found.sum(axis=1), style.GRID),) if len(found) else ()


def _strips(motion: Motion, names: tuple[str, ...]) -> Panel:
    """A row for each joint, marked where it is bridged."""
    gaps = [spans(motion.time, ~seen) for seen in motion.observed.T]
    found = [(j, start, start + wide) for j, own in enumerate(gaps) for start, wide in own]
    row, low, high = np.array(found, dtype=np.float64).reshape(-1, 3).T
    ends = _ends(motion)
    told = () if found else (Text(sum(ends) / 2, (len(names) - 1) / 2, "nowhere"),)
    bars = Bars(row, low, high, tuple(style.colour(j + 1) for j, *_ in found), thick=0.6)
    rows = tuple(style.printable(name, 9) for name in names)
    height = 0.65 + _STRIP * len(names)
    return Panel((bars, *told), "bridged", "time (s)", x_range=ends, rows=rows, linked=True, height=height)


def _ends(motion: Motion) -> tuple[float, float]:
    return float(motion.time[0]), float(motion.time[-1])
