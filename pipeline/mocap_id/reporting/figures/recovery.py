"""How each joint was found: arcs in the frame of the segment before, a rigid body about it (figures 5.2, 6.3)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mocap_id.arrays import FloatArray
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id.kinematics.circle import fit_circles
from mocap_id.reporting import style
from mocap_id.reporting.material import Material
from mocap_id.reporting.tracks import tracks
from mocap_id.reporting.views import Skeleton

_MOMENTS = 150
_COLUMNS = 4


def draw(material: Material) -> Figure | str:
    """A column a joint: its segment's markers as seen from the segment before, and below from their own."""
    skeleton, motion, planar = material.skeleton, material.motion, material.frame("planar.parquet")
    if skeleton is None or motion is None or planar is None or not len(motion.time):
        return f"No joint to show: {material.why_missing('chain.h5')}."
    sample = np.unique(np.linspace(0, len(motion.time) - 1, _MOMENTS).round().astype(np.int64))
    measured = tracks(planar, motion.time[sample], skeleton.markers)  # (K, M, 2)
    angle, origin = segment_poses(motion.angles[sample], skeleton.centres)
    count = len(skeleton.joints)
    lines = -(-count // _COLUMNS)
    columns = -(-count // lines)
    figure = style.figure(0.5 + 5.0 * lines)
    panels = figure.subplots(2 * lines, columns, squeeze=False)
    for axes in panels.ravel():
        axes.set_axis_off()
    for j in range(count):
        line, column = divmod(j, columns)
        own = skeleton.marker_segment == j + 1
        seen_from = [rotate(-angle[:, k, None], measured[:, own] - origin[:, k, None]) for k in (j, j + 1)]
        _from_before(panels[2 * line, column], seen_from[0], skeleton, j)
        _from_itself(panels[2 * line + 1, column], seen_from[1], skeleton, j)
    style.legend_above(figure, panels.ravel())
    figure.supxlabel("x (m)", fontsize=8)
    figure.supylabel("y (m)", fontsize=8)
    return figure


def _from_before(axes: Axes, points: FloatArray, skeleton: Skeleton, j: int) -> None:
    """Arcs of the markers, the middles of their circles, and the joint."""
    _lines(axes, points, style.colour(j + 1))
    circles = fit_circles(points[..., 0] + 1j * points[..., 1])
    centre = circles.centre[np.isfinite(circles.residual)]
    near = centre[np.abs(centre - complex(*skeleton.centres[j])) < _reach(points, skeleton.centres[j])]
    axes.plot(near.real, near.imag, "+", color=style.INK, ms=5, mew=0.8, label="middle of a marker's own circle")
    _joint(axes, skeleton.centres[j])
    before = style.printable(skeleton.segments[j], 14)
    axes.set_title(f"{style.printable(skeleton.joints[j], 14)}, seen from {before}")


def _from_itself(axes: Axes, points: FloatArray, skeleton: Skeleton, j: int) -> None:
    """What the rigid body leaves over about its markers, and the joints on it."""
    _lines(axes, points, style.colour(j + 1))
    local = skeleton.local[skeleton.marker_segment == j + 1]
    axes.plot(*local.T, "o", ms=4, mfc="none", mec=style.INK, mew=0.7, label="marker of the chain")
    _joint(axes, np.zeros(2))
    if j + 1 < len(skeleton.joints):
        _joint(axes, skeleton.centres[j + 1])
    axes.set_title(f"{style.printable(skeleton.segments[j + 1], 14)}, seen from itself")


def _lines(axes: Axes, points: FloatArray, colour: str) -> None:
    broken = np.concatenate([points, np.full_like(points[:1], np.nan)])  # one line for all, lifted between markers
    x, y = broken.swapaxes(0, 1).reshape(-1, 2).T
    axes.plot(x, y, lw=1.0, alpha=0.8, color=colour)
    axes.set_axis_on()
    axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(nbins=4)


def _joint(axes: Axes, centre: FloatArray) -> None:
    axes.plot(*centre, "o", ms=9, mfc="none", mec=style.INK, mew=1.4, label="joint", zorder=4)


def _reach(points: FloatArray, centre: FloatArray) -> float:
    """The markers' farthest distance from the joint: a circle's middle beyond it would only shrink the drawing."""
    distance = np.linalg.norm(points - centre, axis=-1)
    return float(np.nanmax(distance, initial=0.0))
