"""The figure of a movement that is advised: joint angles within their limits, over the whole recording and closely."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mocap_id.dynamics.course import Course
from mocap_id.dynamics.limits import Limits
from mocap_id.reporting import paper, style

_PANEL = 1.25  # inches
_CLOSELY = 8.0  # s


def draw(course: Course, joints: Sequence[str], limits: Limits, words: str) -> Figure:
    """Draw it; call it under :func:`mocap_id.reporting.paper.house`.

    Parameters
    ----------
    course : Course
    joints : sequence of str
        Their names.
    limits : Limits
        Shaded where an angle may not go.
    words : str
        What to do, above the figure.
    """
    drawing = paper.blank(0.9 + _PANEL * len(joints))
    panels = drawing.subplots(len(joints), 2, squeeze=False, sharey="row", width_ratios=[2, 1])
    time = course.time - course.time[0]
    start = max(0.0, (time[-1] - _CLOSELY) / 2)
    close = (time >= start) & (time <= start + _CLOSELY)
    for j, name in enumerate(joints):
        for axes, part in zip(panels[j], (np.ones_like(close), close), strict=True):
            axes.plot(time[part], np.degrees(course.q[part, j]), color=style.colour(j + 1))
            _bounds(axes, float(np.degrees(limits.low[j])), float(np.degrees(limits.high[j])))
        panels[j, 0].set_ylabel(f"{style.printable(name, 20)} (°)")
    for axes in panels[-1]:
        axes.set_xlabel("time (s)")
    drawing.suptitle("\n".join(textwrap.wrap(style.printable(words), 105)), fontsize=8, x=0.01, ha="left")
    return drawing


def _bounds(axes: Axes, low: float, high: float) -> None:
    """Lines where the limits are."""
    for end in (low, high):
        axes.axhline(end, color=style.FAINT, linewidth=0.8, linestyle=":")
