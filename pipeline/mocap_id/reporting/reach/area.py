"""A workspace in the plane: the motion seen, the samples, the area (figure 7.1), and how it converged."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from mocap_id.arrays import FloatArray
from mocap_id.prescription.workspace import Workspace
from mocap_id.reporting import paper, style

_SHOWN = 1500


def draw(workspace: Workspace, seen: FloatArray, joint: FloatArray) -> Figure:
    """Four panels.

    Parameters
    ----------
    workspace : Workspace
    seen : (T, 2) array
        Where the tip was in the recording, m; none for a chain written in YAML.
    joint : (2,) array
        The first joint, m.
    """
    figure = paper.blank(2.6)
    track, cloud, area, converged = figure.subplots(1, 4)
    every = max(1, len(seen) // _SHOWN)
    track.plot(*seen[::every].T, ".", ms=1.5, color=style.VERMILLION)
    cloud.plot(*workspace.shape.points[:_SHOWN].T, ".", ms=1.2, color=style.VERMILLION)
    for axes in (cloud, area):
        edge(axes, workspace)
    simplices = workspace.shape.triangulation.simplices[workspace.shape.kept]
    filled = PolyCollection(list(workspace.shape.points[simplices]), facecolors=style.SKY, rasterized=True)
    area.add_collection(filled)
    titles = ("the tip as recorded", "sampled postures", _told(workspace))
    for axes, title in zip((track, cloud, area), titles, strict=True):
        axes.plot(*joint, "o", ms=5, mfc="none", mec=style.INK)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(title=title, xlabel="x (m)")
    track.set_ylabel("y, up (m)")
    convergence(converged, workspace, "m²")
    return figure


def edge(axes: Axes, workspace: Workspace, colour: str = style.BLUE) -> None:
    """The edge of the shape, as it stands."""
    segments = workspace.shape.points[workspace.shape.boundary()]
    axes.add_collection(LineCollection(list(segments), colors=colour, linewidths=0.9, rasterized=True))
    axes.autoscale_view()


def convergence(axes: Axes, workspace: Workspace, unit: str) -> None:
    """Measure against samples, and the interval of the last."""
    counts, _, values = zip(*workspace.convergence, strict=True)
    axes.axhspan(*workspace.interval, color=style.BLUE, alpha=0.15, lw=0)
    axes.plot(counts, values, "o-", ms=3, color=style.BLUE)
    axes.set_xscale("log")
    axes.set_xticks(counts, [f"{count:d}" for count in counts], rotation=45)
    axes.minorticks_off()
    axes.set(title=f"convergence ({unit})", xlabel="samples")


def _told(workspace: Workspace) -> str:
    half = 0.5 * (workspace.interval[1] - workspace.interval[0])
    return f"{workspace.measure:.4f} ± {half:.4f} m²"
