"""Base parameters with their intervals and the allometric reference (figure 6.8)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mocap_id.arrays import IntArray
from mocap_id.reporting import style
from mocap_id.reporting.material import Material
from mocap_id.reporting.numbers import NORMAL_95
from mocap_id.reporting.views import Dynamics

_ROW = 0.24  # inches per parameter


def draw(material: Material) -> Figure | str:
    """A panel per unit: dot and 95 % interval for each parameter, a cross for the reference."""
    dynamics = material.dynamics
    if dynamics is None or not np.isfinite(dynamics.value).any():
        why = material.facts("dynamics.h5").get("why") or material.why_missing("dynamics.h5")
        return f"No base parameters: {why}."
    units = list(dict.fromkeys(dynamics.units))
    members = [np.flatnonzero([own == unit for own in dynamics.units]) for unit in units]
    figure = style.figure(0.9 + _ROW * len(dynamics.names) + 0.35 * len(units))
    heights = [len(member) + 0.5 for member in members]
    panels = figure.subplots(len(units), squeeze=False, height_ratios=heights)[:, 0]
    for axes, unit, member in zip(panels, units, members, strict=True):
        _panel(axes, dynamics, member)
        axes.set_xlabel(style.unit(unit))
    style.legend_above(figure, list(panels))
    return figure


def _panel(axes: Axes, dynamics: Dynamics, member: IntArray) -> None:
    rows = np.arange(len(member))
    half = NORMAL_95 * np.where(np.isfinite(dynamics.sd[member]), dynamics.sd[member], 0.0)
    axes.errorbar(
        dynamics.value[member], rows, xerr=half, fmt="o", color=style.MODEL, ms=4, capsize=2.5, label="identified, 95 %"
    )
    reference = dynamics.base_reference[member]
    if np.isfinite(reference).any():
        axes.plot(reference, rows, "x", color=style.REFERENCE, ms=6, mew=1.6, label="allometric reference")
    axes.axvline(0.0, color=style.INK, lw=0.5)
    axes.set_yticks(rows, [style.printable(dynamics.names[i], 34) for i in member])
    axes.set_ylim(len(member) - 0.5, -0.5)
