"""How each joint was found: marker arcs and rigid segments (figures 5.2, 6.3), and residuals of the markers."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id.kinematics.circle import fit_circles
from mocap_id.reporting import style
from mocap_id.reporting.figure import Bars, Figure, Item, Key, Line, Panel, Points, arrange_in_lines
from mocap_id.reporting.markers import read_positions
from mocap_id.reporting.report_data import ReportData
from mocap_id.store.views import Skeleton

_MOMENTS = 150
_COLUMNS = 4


def draw(data: ReportData) -> Figure | str:
    """Return a column for each joint: the markers of its segment in the previous segment and in their own segment."""
    skeleton, motion, planar = data.skeleton, data.motion, data.long("planar.parquet")
    if skeleton is None or motion is None or planar is None or not len(motion.time):
        return f"No joint to show: {data.why_missing('chain.h5')}."
    sample = np.unique(np.linspace(0, len(motion.time) - 1, _MOMENTS).round().astype(np.int64))
    measured = read_positions(planar, motion.time[sample], skeleton.markers)  # (K, M, 2)
    angle, origin = segment_poses(motion.angles[sample], skeleton.centres)
    before, itself = [], []
    for j in range(len(skeleton.joints)):
        own = measured[:, skeleton.marker_segment == j + 1]
        seen = [rotate(-angle[:, k, None], own - origin[:, k, None]) for k in (j, j + 1)]
        before.append(_draw_in_previous(seen[0], skeleton, j))
        itself.append(_draw_in_own(seen[1], skeleton, j))
    pairs = zip(arrange_in_lines(tuple(before), _COLUMNS), arrange_in_lines(tuple(itself), _COLUMNS), strict=True)
    return Figure(tuple(line for pair in pairs for line in pair))


def _draw_in_previous(points: FloatArray, skeleton: Skeleton, j: int) -> Panel:
    """Return the panel in the frame of the previous segment: paths of the markers, their circle centres, the joint.

    ``points`` (K, M, 2) are the positions of the markers, m. Circle centres far from the joint are left out.
    """
    circles = fit_circles(points[..., 0] + 1j * points[..., 1])
    centre = circles.centre[np.isfinite(circles.residual)]
    near = centre[np.abs(centre - complex(*skeleton.centres[j])) < _find_reach(points, skeleton.centres[j])]
    centres_near = Points(near.real, near.imag, style.INK, "circle centre of one marker", "+", 5.0)
    title = f"{style.clean(skeleton.joints[j], 14)} in frame of {style.clean(skeleton.segments[j], 14)}"
    items = (_draw_tracks(points, style.pick_colour(j + 1)), centres_near, _draw_joint(skeleton.centres[j]))
    return Panel(items, title, "x (m)", "y (m)", equal=True, height=2.8)


def _draw_in_own(points: FloatArray, skeleton: Skeleton, j: int) -> Panel:
    """Return the panel in the frame of the own segment: paths of the markers (K, M, 2), and the segment's joints."""
    local = skeleton.local[skeleton.marker_segment == j + 1]
    ends = [np.zeros(2), *skeleton.centres[j + 1 : j + 2]]
    items: tuple[Item, ...] = (
        _draw_tracks(points, style.pick_colour(j + 1)),
        Points(local[:, 0], local[:, 1], style.INK, "marker of the chain", "ring", 4.0),
        *(_draw_joint(end) for end in ends),
    )
    title = f"{style.clean(skeleton.segments[j + 1], 14)} in own frame"
    return Panel(items, title, "x (m)", "y (m)", equal=True, height=2.8)


def _draw_tracks(points: FloatArray, colour: str) -> Line:
    """Return the paths of all markers as one line that is interrupted between two markers."""
    broken = np.concatenate([points, np.full_like(points[:1], np.nan)])
    x, y = broken.swapaxes(0, 1).reshape(-1, 2).T
    return Line(x, y, colour, width=1.0, opacity=0.8)


def _draw_joint(centre: FloatArray) -> Points:
    return Points(centre[:1], centre[1:], style.INK, "joint", "ring", 9.0)


def _find_reach(points: FloatArray, centre: FloatArray) -> float:
    """Return the largest distance of a marker from the joint, m."""
    distance = np.linalg.norm(points - centre, axis=-1)
    return float(np.nanmax(distance, initial=0.0))


_ROW = 0.155  # inches per marker
_MOST_MARKERS = 80  # markers in the figure; the table lists all


def draw_residuals(data: ReportData) -> Figure | str:
    """Return a bar for each of the largest residuals, grouped by segment; within a group, the largest is first."""
    found = [one for one in data.residuals.values() if np.isfinite(one.rms)]
    if not found:
        return f"No residuals: {data.why_missing('markers.parquet')}."
    worst = sorted(found, key=lambda one: -one.rms)[:_MOST_MARKERS]
    of = sorted(worst, key=lambda one: one.segment)  # stable: the worst stay first
    rms, q95 = 1e3 * np.array([one.rms for one in of]), 1e3 * np.array([one.q95 for one in of])
    rows = np.arange(len(of), dtype=np.float64)
    labels = tuple(style.clean(one.label, 24) for one in of)
    texts = tuple(
        f"{label}: {value:.1f} mm, 95 % {most:.1f}" for label, value, most in zip(labels, rms, q95, strict=True)
    )
    names = data.segment_names
    keys = (
        Key(style.pick_colour(k), style.clean(names[k], 20) if 0 <= k < len(names) else "no segment")
        for k in sorted({one.segment for one in of})
    )
    items: tuple[Item, ...] = (
        *keys,
        Bars(rows, np.zeros(len(of)), rms, tuple(style.pick_colour(one.segment) for one in of), names=texts),
        Points(q95, rows, style.INK, "95 % quantile", "|", 6.0),
    )
    title = f"{len(of)} largest residuals of {len(found)} markers" if len(of) < len(found) else ""
    most = (0.0, 1.05 * float(max(rms.max(), q95.max())))
    panel = Panel(items, title, "residual (mm)", x_range=most, rows=labels, height=0.6 + _ROW * len(of))
    return Figure(((panel,),))
