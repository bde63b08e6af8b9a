"""The map of springs by their reachable sets (figure 7.9, left)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from mocap_id.arrays import FloatArray
from mocap_id.reporting import paper


def draw(stiffness: FloatArray, rest: FloatArray, width: FloatArray, horizon: float) -> Figure:
    """Range over stiffness and rest angle; blank where the spring has no equilibrium within the joint's limits.

    Parameters
    ----------
    stiffness, rest : (K,), (R,) arrays
        N·m/rad, rad.
    width : (K, R) array
        rad.
    horizon : float
        s.
    """
    figure = paper.blank(3.6)
    axes = figure.subplots()
    shown = np.ma.masked_invalid(np.degrees(width))
    cells = axes.pcolormesh(np.degrees(rest), stiffness, shown, cmap=paper.HEAT, shading="nearest", rasterized=True)
    figure.colorbar(cells, ax=axes, label="range (°)")
    title = f"reached within {horizon:g} s and held"
    axes.set(xlabel="rest angle (°)", ylabel="stiffness (N·m/rad)", title=title)
    axes.grid(False)
    return figure
