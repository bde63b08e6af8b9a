"""How each joint was found: arcs in the frame of the segment before, a rigid body about it (figures 5.2, 6.3)."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id.kinematics.circle import fit_circles
from mocap_id.reporting import style
from mocap_id.reporting.figure import Figure, Item, Line, Panel, Points, in_lines
from mocap_id.reporting.material import Material
from mocap_id.reporting.tracks import tracks
from mocap_id.reporting.views import Skeleton

_MOMENTS = 150
_COLUMNS = 4


def shown(material: Material) -> Figure | str:
    """A column a joint: its segment's markers as seen from the segment before, and below from their own."""
    skeleton, motion, planar = material.skeleton, material.motion, material.long("planar.parquet")
    if skeleton is None or motion is None or planar is None or not len(motion.time):
        return f"No joint to show: {material.why_missing('chain.h5')}."
    sample = np.unique(np.linspace(0, len(motion.time) - 1, _MOMENTS).round().astype(np.int64))
    measured = tracks(planar, motion.time[sample], skeleton.markers)  # (K, M, 2)
    angle, origin = segment_poses(motion.angles[sample], skeleton.centres)
    before, itself = [], []
    for j in range(len(skeleton.joints)):
        own = measured[:, skeleton.marker_segment == j + 1]
        seen = [rotate(-angle[:, k, None], own - origin[:, k, None]) for k in (j, j + 1)]
        before.append(_from_before(seen[0], skeleton, j))
        itself.append(_from_itself(seen[1], skeleton, j))
    pairs = zip(in_lines(tuple(before), _COLUMNS), in_lines(tuple(itself), _COLUMNS), strict=True)
    return Figure(tuple(line for pair in pairs for line in pair))


def _from_before(points: FloatArray, skeleton: Skeleton, j: int) -> Panel:
    """Markers (K, M, 2) about the joint, and the middles of their own circles as far as these lie near by."""
    circles = fit_circles(points[..., 0] + 1j * points[..., 1])
    centre = circles.centre[np.isfinite(circles.residual)]
    near = centre[np.abs(centre - complex(*skeleton.centres[j])) < _reach(points, skeleton.centres[j])]
    middles = Points(near.real, near.imag, style.INK, "middle of a marker's own circle", "+", 5.0)
    title = f"{style.printable(skeleton.joints[j], 14)}, seen from {style.printable(skeleton.segments[j], 14)}"
    items = (_tracks(points, style.colour(j + 1)), middles, _joint(skeleton.centres[j]))
    return Panel(items, title, "x (m)", "y (m)", equal=True, height=2.8)


def _from_itself(points: FloatArray, skeleton: Skeleton, j: int) -> Panel:
    """What the rigid body leaves over about its markers, and the joints on it."""
    local = skeleton.local[skeleton.marker_segment == j + 1]
    ends = [np.zeros(2), *skeleton.centres[j + 1 : j + 2]]
    items: tuple[Item, ...] = (
        _tracks(points, style.colour(j + 1)),
        Points(local[:, 0], local[:, 1], style.INK, "marker of the chain", "ring", 4.0),
        *(_joint(end) for end in ends),
    )
    title = f"{style.printable(skeleton.segments[j + 1], 14)}, seen from itself"
    return Panel(items, title, "x (m)", "y (m)", equal=True, height=2.8)


def _tracks(points: FloatArray, colour: str) -> Line:
    """One line for all markers, lifted between them."""
    broken = np.concatenate([points, np.full_like(points[:1], np.nan)])
    x, y = broken.swapaxes(0, 1).reshape(-1, 2).T
    return Line(x, y, colour, width=1.0, opacity=0.8)


def _joint(centre: FloatArray) -> Points:
    return Points(centre[:1], centre[1:], style.INK, "joint", "ring", 9.0)


def _reach(points: FloatArray, centre: FloatArray) -> float:
    """The markers' farthest distance from the joint: a circle's middle beyond it would only shrink the drawing."""
    distance = np.linalg.norm(points - centre, axis=-1)
    return float(np.nanmax(distance, initial=0.0))
