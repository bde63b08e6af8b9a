"""Two sessions over each other: kept, gained and lost."""

from __future__ import annotations

from matplotlib.figure import Figure

from mocap_id.prescription.overlay import Overlay
from mocap_id.reporting import paper, style

_SHOWN = 6000
_PLANES = {2: (("in the plane", 0, 1),), 3: (("front", 2, 1), ("side", 0, 1), ("top", 2, 0))}


def draw(change: Overlay, names: tuple[str, str]) -> Figure:
    """One panel in the plane, three projections in space; ``names`` are the earlier and the later session's."""
    planes = _PLANES[change.points.shape[1]]
    figure = paper.blank(3.4)
    kinds = (
        (change.before & change.after, style.FAINT, f"both, {change.kept:.4f}"),
        (change.after & ~change.before, style.GREEN, f"gained: {style.printable(names[1], 24)}, {change.gained:.4f}"),
        (change.before & ~change.after, style.VERMILLION, f"lost: {style.printable(names[0], 24)}, {change.lost:.4f}"),
    )
    panels = figure.subplots(1, len(planes), squeeze=False)[0]
    every = max(1, len(change.points) // _SHOWN)
    for axes, (name, across, up) in zip(panels, planes, strict=True):
        for which, colour, label in kinds:
            points = change.points[which][::every]
            axes.plot(points[:, across], points[:, up], ".", ms=1.4, color=colour, label=label)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(title=name, xlabel=f"{'xyz'[across]} (m)", ylabel=f"{'xyz'[up]} (m)")
    paper.legend_above(figure, panels)
    return figure
