"""Contact wrench over repetitions: measured, and of every model (figures 5.4 and 5.5)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Band, Dash, Figure, Item, Line, Panel
from mocap_id.reporting.robot_study.page_data import AveragedWrench

CAPTION = (
    "Mean over the repetitions of the cell's trials, with one standard deviation to either side as a band. Measured "
    "(black), reference parameters (orange), states from the encoder (R, green), states from the cameras (P, blue)."
)
RESIDUALS = "The same models less the measured wrench: mean and one standard deviation over the repetitions."
_NAMES = ("Fx (N)", "Fy (N)", "τz (N·m)")
_LOOKS: Mapping[str, tuple[str, Dash, float]] = {
    "measured": (style.MEASURED, "-", 1.0),
    "Ref.": (style.ORANGE, "-", 1.6),
    "R": (style.GREEN, "--", 1.4),
    "P": (style.BLUE, "-", 1.0),
}


def draw(found: AveragedWrench) -> Figure:
    """Return measured and modelled wrench."""
    return _figure(found, {"measured": found.measured, **found.models})


def draw_errors(found: AveragedWrench) -> Figure:
    """Return the modelled less the measured wrench."""
    return _figure(found, found.errors)


def _figure(found: AveragedWrench, series: Mapping[str, FloatArray]) -> Figure:
    panels = []
    for d, title in enumerate(_NAMES):
        items: list[Item] = []
        for name, (colour, dash, width) in _LOOKS.items():
            if name in series:
                mean, sd = series[name][..., d].mean(axis=0), np.std(series[name][..., d], axis=0)
                items.append(Band(found.phase, mean - sd, mean + sd, colour, 0.15))
                items.append(Line(found.phase, mean, colour, name, dash, width))
        panels.append(Panel(tuple(items), title, "repetition (%)", linked=True, height=2.2))
    return Figure((tuple(panels),))
