"""Contact wrench over repetitions: measured, and of every model (figures 5.4 and 5.5)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.robot.material import Averaged

CAPTION = (
    "Mean over the repetitions of the cell's trials, one standard deviation either way as a band. Measured (black), "
    "reference parameters (orange), states from the encoder (R, green), states from the cameras (P, blue)."
)
RESIDUALS = "The same models less the measured wrench: mean and one standard deviation over the repetitions."
_NAMES = ("Fx (N)", "Fy (N)", "τz (N·m)")
_LOOKS = {"Ref.": (style.ORANGE, "-", 1.6), "R": (style.GREEN, "--", 1.4), "P": (style.BLUE, "-", 1.0)}


def draw(found: Averaged) -> Figure:
    """Measured and modelled."""
    return _drawn(found, found.models, measured=True)


def draw_residuals(found: Averaged) -> Figure:
    """Modelled less measured."""
    return _drawn(found, found.errors, measured=False)


def _drawn(found: Averaged, series: Mapping[str, FloatArray], *, measured: bool) -> Figure:
    drawing = style.figure(2.6)
    panels = list(drawing.subplots(1, 3))
    for d, axes in enumerate(panels):
        if measured:
            _band(axes, found.phase, found.measured[..., d], "measured", (style.MEASURED, "-", 1.0))
        for name, look in _LOOKS.items():
            if name in series:
                _band(axes, found.phase, series[name][..., d], name, look)
        axes.set_title(_NAMES[d])
        axes.set_xlabel("repetition (%)")
    style.legend_above(drawing, panels[:1])
    return drawing


def _band(axes: Axes, phase: FloatArray, series: FloatArray, name: str, look: tuple[str, str, float]) -> None:
    colour, line, width = look
    mean, sd = np.mean(series, axis=0), np.std(series, axis=0)
    axes.fill_between(phase, mean - sd, mean + sd, color=colour, alpha=0.15, lw=0)
    axes.plot(phase, mean, line, color=colour, lw=width, label=name)
