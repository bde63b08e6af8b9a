"""A workspace in space: the surface, its three projections, and how it converged (figures 7.3 and 7.4)."""

from __future__ import annotations

from typing import Any

from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from mocap_id.arrays import FloatArray
from mocap_id.prescription.workspace import Workspace
from mocap_id.reporting import paper, style
from mocap_id.reporting.reach.area import convergence

_PLANES = (("front", 2, 1), ("side", 0, 1), ("top", 2, 0))


def draw(workspace: Workspace, joint: FloatArray) -> Figure:
    """The surface beside projections onto the coordinate planes; ``joint`` (3,) is the first joint, m."""
    figure = paper.blank(5.0)
    grid = figure.add_gridspec(2, 3)
    points, facets = workspace.shape.points, workspace.shape.boundary()
    solid: Any = figure.add_subplot(grid[0, :2], projection="3d")
    solid.plot_trisurf(points[:, 2], points[:, 0], points[:, 1], triangles=facets, color=style.SKY, rasterized=True)
    solid.scatter(joint[2], joint[0], joint[1], color=style.INK)
    solid.set(xlabel="z (m)", ylabel="x (m)", zlabel="y (m)", title=f"{workspace.measure:.4f} m³")
    convergence(figure.add_subplot(grid[0, 2]), workspace, "m³")
    for k, (name, across, up) in enumerate(_PLANES):
        axes = figure.add_subplot(grid[1, k])
        shadow = list(points[facets][:, :, [across, up]])
        axes.add_collection(PolyCollection(shadow, facecolors=style.SKY, edgecolors=style.SKY, rasterized=True))
        axes.autoscale_view()
        axes.plot(joint[across], joint[up], "o", ms=5, mfc="none", mec=style.INK)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(title=name, xlabel=f"{'xyz'[across]} (m)", ylabel=f"{'xyz'[up]} (m)")
    return figure
