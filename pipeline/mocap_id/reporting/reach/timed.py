"""When each state is reached, and what of it can be held (figure 7.9, right)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from mocap_id.prescription.level_set import Dynamics, Reached
from mocap_id.reporting import paper, style


def draw(reached: Reached, bounds: Sequence[tuple[float, float] | None], dynamics: Dynamics) -> Figure:
    """Time of arrival over angle and velocity, the fronts at the horizons, and the held range at the last."""
    figure = paper.blank(3.6)
    axes = figure.subplots()
    grid = reached.grid
    angle = np.degrees(grid.angle)
    arrival = np.where(np.isfinite(reached.arrival), reached.arrival, np.nan)
    levels = np.linspace(0.0, reached.times[-1], paper.SHADES + 1)
    shades = axes.contourf(angle, grid.velocity, arrival.T, levels=levels, cmap=paper.HEAT)
    figure.colorbar(shades, ax=axes, label="first reached (s)")
    for values in reached.values:
        axes.contour(angle, grid.velocity, values.T, levels=[0.0], colors=style.INK, linewidths=0.7)
    if bounds[-1] is not None:
        for end in bounds[-1]:
            axes.axvline(np.degrees(end), color=style.INK, lw=1.2)
    start = dynamics.equilibrium()
    if start is not None:
        axes.plot(np.degrees(start), 0.0, "x", color=style.VERMILLION)
    axes.set(xlabel="angle (°)", ylabel="velocity (rad/s)", title="reached from rest at the cross, within the time")
    return figure
