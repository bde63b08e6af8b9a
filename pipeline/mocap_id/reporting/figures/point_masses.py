"""The grid of point masses of each segment as a heat map (figure 6.9)."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from mocap_id.reporting import style
from mocap_id.reporting.material import Material
from mocap_id.reporting.views import Dynamics

_COLUMNS = 4
_CARRIES = 1e-3  # kg; a point below this carries nothing worth a colour


def draw(material: Material) -> Figure | str:
    """A panel per body in its own frame, one colour scale for all."""
    dynamics = material.dynamics
    if dynamics is None or not np.isfinite(dynamics.grid_mass).any():
        facts = material.facts("dynamics.h5")
        why = facts.get("why") or material.why_missing("dynamics.h5")
        if facts.get("consistency") in ("cone", "bounded-cone"):
            why = (
                "the fit finds mass, first moments and inertia of every body within the exact cone of bodies that "
                "can exist, but no point masses"
            )
        return f"No point masses: {why}."
    segments = np.unique(dynamics.grid_segment).tolist()
    lines = -(-len(segments) // _COLUMNS)
    columns = -(-len(segments) // lines)
    figure = style.figure(0.6 + 3.0 * lines)
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    scale = Normalize(0.0, max(float(np.nanmax(dynamics.grid_mass)), _CARRIES))
    for axes in panels[len(segments) :]:
        axes.set_axis_off()
    for axes, k in zip(panels, segments, strict=False):
        drawn = _panel(axes, dynamics, k, scale)
        name = material.body_names[k] if k < len(material.body_names) else f"segment {k}"
        total = float(np.nansum(dynamics.grid_mass[dynamics.grid_segment == k]))
        axes.set_title(f"{style.printable(name, 18)}\n{total:.1f} kg")
    figure.colorbar(drawn, ax=panels.tolist(), label="mass of a point (kg)", shrink=0.7, aspect=30)
    figure.supxlabel("x in the segment's frame (m)", fontsize=8)
    figure.supylabel("y in the segment's frame (m)", fontsize=8)
    return figure


def _panel(axes: Axes, dynamics: Dynamics, segment: int, scale: Normalize) -> PathCollection:
    own = dynamics.grid_segment == segment
    position, mass = dynamics.grid_position[own], dynamics.grid_mass[own]
    carries = mass > _CARRIES
    axes.plot(*position[~carries].T, ".", color=style.GRID, ms=3)
    axes.plot(0, 0, "+", color=style.INK, ms=8, mew=1.2)
    axes.set_aspect("equal")
    axes.margins(0.12)
    axes.grid(False)
    return axes.scatter(
        position[carries, 0],
        position[carries, 1],
        c=mass[carries],
        s=12,
        marker="s",
        cmap=mpl.colormaps[style.HEAT].resampled(style.SHADES),
        norm=scale,
        linewidths=0.3,
        edgecolors=style.INK,
        zorder=3,
    )
