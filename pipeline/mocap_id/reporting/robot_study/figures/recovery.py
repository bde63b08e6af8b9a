"""Markers, circles, skeleton and states of one trial (figures 5.2 and 5.3)."""

from __future__ import annotations

import numpy as np

from mocap_id.reporting import style
from mocap_id.reporting.downsampling import envelope
from mocap_id.reporting.figure import Figure, Item, Line, Panel, Points, Text
from mocap_id.reporting.robot_study.page_data import Recovery

CAPTION = (
    "Above, the markers' paths in the plane: stationary ones as crosses, those of the moving body in colour, and the "
    "joint's centre as a circle; beside it, the moving markers in their segment's frame. Below, angle, velocity and "
    "acceleration by the smoother (blue) over low-pass and differences at 20 Hz (red)."
)
_QUANTITIES = ("angle (rad)", "velocity (rad/s)", "acceleration (rad/s²)")
_LOOKS = {"Diff.": (style.OTHER, 0.6), "P": (style.BLUE, 1.1)}


def draw(one: Recovery) -> Figure:
    """Return the plane beside the segment, and below them the states over time."""
    return Figure(((_plane(one), _segment(one)), *((_states(one, order),) for order in range(3))))


def _plane(one: Recovery) -> Panel:
    still = [np.nanmean(path, axis=0) for label, path in one.paths.items() if one.segment[label] == 0]
    moving = [path for label, path in one.paths.items() if one.segment[label] > 0]
    x, y = np.array(still).reshape(-1, 2).T
    items: list[Item] = [Points(x, y, style.FAINT, symbol="x")]
    items += [Line(path[:, 0], path[:, 1], style.colour(k), width=1.2) for k, path in enumerate(moving, start=1)]
    items.append(Points(one.centre[:1], one.centre[1:], style.GREEN, symbol="ring", size=9.0))
    return Panel(tuple(items), "markers and joint", "x (m)", "y (m)", equal=True, height=3.0)


def _segment(one: Recovery) -> Panel:
    own = {label: local for label, local in one.local.items() if one.segment[label] > 0}
    nothing = np.zeros(1)
    x, y = np.array(list(own.values())).reshape(-1, 2).T
    items: tuple[Item, ...] = (
        Points(x, y, style.INK, symbol="x"),
        *(Text(float(local[0]), float(local[1]), style.printable(label, 8)) for label, local in own.items()),
        Points(nothing, nothing, style.GREEN, symbol="ring", size=9.0),
    )
    return Panel(items, "in the segment", "x (m)", "y (m)", equal=True, height=3.0)


def _states(one: Recovery, order: int) -> Panel:
    """Return the angle, velocity or acceleration by every method, the smoother's on top."""
    curves = one.traces.curves
    items = tuple(
        Line(*envelope(one.traces.time, curves[name][:, order], 150), colour, name, width=width)
        for name, (colour, width) in _LOOKS.items()
        if name in curves
    )
    below, height = ("time (s)", 1.5) if order == 2 else ("", 1.2)
    return Panel(items, x=below, y=_QUANTITIES[order], linked=True, height=height)
