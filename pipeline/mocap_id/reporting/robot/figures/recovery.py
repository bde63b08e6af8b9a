"""Markers, circles, skeleton and states of one trial (figures 5.2 and 5.3)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.decimation import envelope
from mocap_id.reporting.robot.material import Recovery

CAPTION = (
    "Left, the markers' ways in the plane: stationary ones as crosses, those of the moving body in colour, and the "
    "joint's centre as a circle. Middle, the moving markers in their segment's frame. Right, angle, velocity and "
    "acceleration by the smoother (blue) over low-pass and differences at 20 Hz (red)."
)
_QUANTITIES = ("angle (rad)", "velocity (rad/s)", "acceleration (rad/s²)")
_LOOKS = {"Diff.": (style.OTHER, 0.6), "P": (style.BLUE, 1.1)}


def draw(one: Recovery) -> Figure:
    """Three columns: the plane, the segment, the states over time."""
    drawing = style.figure(4.0)
    layout = drawing.add_gridspec(3, 3, width_ratios=(1.1, 0.8, 1.6))
    _plane(drawing.add_subplot(layout[:, 0]), one)
    _segment(drawing.add_subplot(layout[:, 1]), one)
    panels = [drawing.add_subplot(layout[k, 2]) for k in range(3)]
    states_over_time(panels, one.traces.time, one.traces.curves)
    style.legend_above(drawing, panels[:1])
    return drawing


def _plane(axes: Axes, one: Recovery) -> None:
    moving = 0
    for label, path in one.paths.items():
        if one.segment[label] == 0:
            axes.plot(*np.nanmean(path, axis=0), "x", color=style.FAINT, ms=4)
        else:
            moving += 1
            axes.plot(*path.T, color=style.colour(moving), lw=1.2)
    axes.plot(*one.centre, "o", mfc="none", mew=1.6, ms=9, color=style.GREEN)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("markers and joint (m)")


def _segment(axes: Axes, one: Recovery) -> None:
    for label, local in one.local.items():
        if one.segment[label] > 0:
            axes.plot(*local, "x", color=style.INK, ms=4)
            axes.annotate(
                style.printable(label, 8), (local[0], local[1]), (3, 0), textcoords="offset points", fontsize=6
            )
    axes.plot(0, 0, "o", mfc="none", mew=1.6, ms=9, color=style.GREEN)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("in the segment (m)")


def states_over_time(panels: list[Axes], time: FloatArray, curves: Mapping[str, FloatArray]) -> None:
    """Angle, velocity and acceleration by every method, the smoother's on top."""
    for d, (axes, name) in enumerate(zip(panels, _QUANTITIES, strict=True)):
        for method in sorted(curves, key=list(_LOOKS).index):
            colour, width = _LOOKS[method]
            axes.plot(*envelope(time, curves[method][:, d], 150), color=colour, lw=width, label=method)
        axes.set_title(name)
        if d < 2:
            axes.tick_params(labelbottom=False)
    panels[-1].set_xlabel("time (s)")
