"""Figures of reachable workspaces in the plane and in space, and of their change (thesis figures 7.1, 7.3 and 7.4)."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from mocap_id.arrays import FloatArray
from mocap_id.prescription.workspace import Overlay, Workspace
from mocap_id.reporting import paper_figures, style

_TIPS, _CHANGES = 1500, 6000  # maximum number of points that are drawn
_VIEWS = (("front", 2, 1), ("side", 0, 1), ("top", 2, 0))


def draw_area(workspace: Workspace, recorded: FloatArray, joint: FloatArray) -> Figure:
    """Return the figure of a planar workspace: recorded tips, sampled postures, area, and convergence (figure 7.1).

    Parameters
    ----------
    workspace : Workspace
        Set of tip positions that can be reached.
    recorded : (T, 2) array
        Tip positions in the recording, m; empty if the chain is not from a recording but defined in YAML.
    joint : (2,) array
        Position of the first joint, m.
    """
    figure = paper_figures.make_figure(2.6)
    track, cloud, area, converged = figure.subplots(1, 4)
    every = max(1, len(recorded) // _TIPS)
    track.plot(*recorded[::every].T, ".", ms=1.5, color=style.VERMILLION)
    cloud.plot(*workspace.shape.points[:_TIPS].T, ".", ms=1.2, color=style.VERMILLION)
    for axes in (cloud, area):
        _draw_edge(axes, workspace)
    simplices = workspace.shape.triangulation.simplices[workspace.shape.kept]
    filled = PolyCollection(list(workspace.shape.points[simplices]), facecolors=style.SKY, rasterized=True)
    area.add_collection(filled)
    half = 0.5 * (workspace.interval[1] - workspace.interval[0])
    titles = ("recorded tip", "sampled postures", f"{workspace.measure:.4f} ± {half:.4f} m²")
    for axes, title in zip((track, cloud, area), titles, strict=True):
        _draw_joint(axes, joint)
        axes.set(title=title, xlabel="x (m)")
    track.set_ylabel("y, up (m)")
    _draw_convergence(converged, workspace, "m²")
    return figure


def draw_volume(workspace: Workspace, joint: FloatArray) -> Figure:
    """Return the figure of a spatial workspace: surface, convergence, and three projections (figures 7.3 and 7.4).

    Parameters
    ----------
    workspace : Workspace
        Set of tip positions that can be reached.
    joint : (3,) array
        Position of the first joint, m.
    """
    figure = paper_figures.make_figure(5.0)
    grid = figure.add_gridspec(2, 3)
    points, facets = workspace.shape.points, workspace.shape.boundary()
    solid: Any = figure.add_subplot(grid[0, :2], projection="3d")
    solid.plot_trisurf(points[:, 2], points[:, 0], points[:, 1], triangles=facets, color=style.SKY, rasterized=True)
    solid.scatter(joint[2], joint[0], joint[1], color=style.INK)
    solid.set(xlabel="z (m)", ylabel="x (m)", zlabel="y (m)", title=f"{workspace.measure:.4f} m³")
    _draw_convergence(figure.add_subplot(grid[0, 2]), workspace, "m³")
    for k, (name, across, up) in enumerate(_VIEWS):
        axes = figure.add_subplot(grid[1, k])
        shadow = list(points[facets][:, :, [across, up]])
        axes.add_collection(PolyCollection(shadow, facecolors=style.SKY, edgecolors=style.SKY, rasterized=True))
        axes.autoscale_view()
        _draw_joint(axes, joint[[across, up]])
        axes.set(title=name, xlabel=f"{'xyz'[across]} (m)", ylabel=f"{'xyz'[up]} (m)")
    return figure


def draw_change(change: Overlay, names: tuple[str, str]) -> Figure:
    """Return the figure of two sessions' workspaces: parts in both, gained and lost; three views in space.

    Parameters
    ----------
    change : Overlay
        The two workspaces on a common set of points.
    names : tuple of str
        Names of the earlier and the later session.
    """
    views = (("in the plane", 0, 1),) if change.points.shape[1] == 2 else _VIEWS
    figure = paper_figures.make_figure(3.4)
    kinds = (
        (change.before & change.after, style.FAINT, f"both, {change.kept:.4f}"),
        (change.after & ~change.before, style.GREEN, f"gained: {style.clean(names[1], 24)}, {change.gained:.4f}"),
        (change.before & ~change.after, style.VERMILLION, f"lost: {style.clean(names[0], 24)}, {change.lost:.4f}"),
    )
    panels = figure.subplots(1, len(views), squeeze=False)[0]
    every = max(1, len(change.points) // _CHANGES)
    for axes, (name, across, up) in zip(panels, views, strict=True):
        for which, colour, label in kinds:
            points = change.points[which][::every]
            axes.plot(points[:, across], points[:, up], ".", ms=1.4, color=colour, label=label)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(title=name, xlabel=f"{'xyz'[across]} (m)", ylabel=f"{'xyz'[up]} (m)")
    paper_figures.add_legend(figure, panels)
    return figure


def _draw_joint(axes: Axes, joint: FloatArray) -> None:
    axes.plot(*joint, "o", ms=5, mfc="none", mec=style.INK)
    axes.set_aspect("equal", adjustable="datalim")


def _draw_edge(axes: Axes, workspace: Workspace) -> None:
    segments = workspace.shape.points[workspace.shape.boundary()]
    axes.add_collection(LineCollection(list(segments), colors=style.BLUE, linewidths=0.9, rasterized=True))
    axes.autoscale_view()


def _draw_convergence(axes: Axes, workspace: Workspace, unit: str) -> None:
    """Draw area or volume against the number of samples, with the interval of the last value."""
    counts, _, values = zip(*workspace.convergence, strict=True)
    axes.axhspan(*workspace.interval, color=style.BLUE, alpha=0.15, lw=0)
    axes.plot(counts, values, "o-", ms=3, color=style.BLUE)
    axes.set_xscale("log")
    axes.set_xticks(counts, [f"{count:d}" for count in counts], rotation=45)
    axes.minorticks_off()
    axes.set(title=f"convergence ({unit})", xlabel="samples")
