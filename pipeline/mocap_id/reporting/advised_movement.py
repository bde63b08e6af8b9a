"""Figure of an advised movement: joint angles with their limits, for the whole movement and for its middle 8 s."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from mocap_id.design.proposal import MovementLimits, Trajectory
from mocap_id.reporting import paper_figures, style

_PANEL = 1.25  # inches
_DETAIL = 8.0  # s


def draw(course: Trajectory, joints: Sequence[str], limits: MovementLimits, words: str) -> Figure:
    """Return the figure; call this within :func:`mocap_id.reporting.paper_figures.use_paper_style`.

    ``limits`` of the angles are dotted lines. ``words``, the instruction for the person, are the title of the figure.
    """
    drawing = paper_figures.make_figure(0.9 + _PANEL * len(joints))
    panels = drawing.subplots(len(joints), 2, squeeze=False, sharey="row", width_ratios=[2, 1])
    time = course.time - course.time[0]
    start = max(0.0, (time[-1] - _DETAIL) / 2)
    close = (time >= start) & (time <= start + _DETAIL)
    for j, name in enumerate(joints):
        for axes, part in zip(panels[j], (np.ones_like(close), close), strict=True):
            axes.plot(time[part], np.degrees(course.q[part, j]), color=style.pick_colour(j + 1))
            for end in (limits.low[j], limits.high[j]):
                axes.axhline(float(np.degrees(end)), color=style.FAINT, linewidth=0.8, linestyle=":")
        panels[j, 0].set_ylabel(f"{style.clean(name, 20)} (°)")
    for axes in panels[-1]:
        axes.set_xlabel("time (s)")
    drawing.suptitle("\n".join(textwrap.wrap(style.clean(words), 105)), fontsize=8, x=0.01, ha="left")
    return drawing
