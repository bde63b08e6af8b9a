"""Recovered chain over the markers at two instants (figure 6.2, left)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id.reporting import style
from mocap_id.reporting.figure import Figure, Item, Line, Panel, Points, Text
from mocap_id.reporting.report_data import ReportData
from mocap_id.store import LongTable, Table
from mocap_id.store.views import JointStates, Skeleton

ALONG, UP = "x, along the motion (m)", "y, up (m)"


@dataclass(frozen=True)
class Moment:
    """The index of a sample of the states, and the name of the posture in it."""

    name: str
    sample: int


def draw(data: ReportData) -> Figure | str:
    """Return stick figure, joint centres, and measured and predicted markers in two postures side by side."""
    skeleton, motion, planar = data.skeleton, data.motion, data.long("planar.parquet")
    moments = () if motion is None else choose_moments(motion, data.table("events.parquet"))
    if skeleton is None or motion is None or not moments:
        return _draw_markers_alone(data, planar)
    found = []
    for moment in moments:
        time = float(motion.time[moment.sample])
        items = (
            *_draw_markers(planar, time, skeleton, filled=True),
            *_draw_markers(data.long("markers.parquet"), time, skeleton, filled=False),
            *_draw_sticks(skeleton, motion.angles[moment.sample]),
        )
        found.append((f"{moment.name}, {time:.2f} s", items))
    across, up = _find_common_ranges([items for _, items in found])
    return Figure(
        (tuple(Panel(items, title, ALONG, UP, across, up, equal=True, height=4.6) for title, items in found),)
    )


def choose_moments(motion: JointStates, events: Table | None) -> tuple[Moment, ...]:
    """Return two postures: before the rise and standing, or without a rise the two extremes of the motion.

    The extremes are the samples that are farthest along the first principal component of the angles. Samples in which
    every joint is observed are preferred. The result is empty if no sample has all angles.
    """
    known = ~np.isnan(motion.angles.sum(axis=1))
    seen = known & (motion.observed.sum(axis=1) == motion.observed.shape[1])
    usable = np.flatnonzero(seen if seen.any() else known)
    if not len(usable):
        return ()
    if events is not None:
        whole = events.stack(["start", "stand"])
        whole = whole[np.isfinite(whole.sum(axis=1))]
        if len(whole):
            nearest = [int(usable[np.abs(motion.time[usable] - time).argmin()]) for time in whole[0]]
            return Moment("before the rise", nearest[0]), Moment("standing", nearest[1])
    angles = motion.angles[usable]
    centred = angles - angles.mean(axis=0)
    along = centred @ np.linalg.eigh(centred.T @ centred)[1][:, -1]
    ends = sorted({int(usable[along.argmin()]), int(usable[along.argmax()])})
    return tuple(Moment(f"extreme posture {k + 1}", sample) for k, sample in enumerate(ends))


def _draw_markers(table: LongTable | None, time: float, skeleton: Skeleton | None, *, filled: bool) -> list[Item]:
    """Return the markers in the frame nearest to ``time``, coloured by segment; dots if ``filled``, else rings."""
    if table is None or not table.length:
        return []
    frame = int(np.abs(table.time - time).argmin())
    x, y = table.values["x"][frame], table.values["y"][frame]
    known = {} if skeleton is None else dict(zip(skeleton.markers, skeleton.marker_segment.tolist(), strict=True))
    segment = np.array([known.get(label, -1) for label in table.labels])
    names = np.array([style.clean(label, 24) for label in table.labels])
    items: list[Item] = []
    for k in np.unique(segment).tolist():
        own = (segment == k) & np.isfinite(x) & np.isfinite(y)
        symbol = "x" if k < 0 else "dot" if filled else "ring"
        size = 3.5 if filled else 5.5
        items.append(
            Points(x[own], y[own], style.pick_colour(k), symbol=symbol, size=size, names=tuple(names[own].tolist()))  # type: ignore[arg-type]
        )
    return items


def _draw_sticks(skeleton: Skeleton, angles: FloatArray) -> list[Item]:
    """Return joints with names, and a line for each moving segment from its joint to the next.

    The last line ends at the centroid of the markers of its segment.
    """
    angle, origin = segment_poses(angles, skeleton.centres)
    points = np.vstack([origin[1:], origin[-1] + rotate(angle[-1], skeleton.tip)])
    items: list[Item] = []
    for j, name in enumerate(skeleton.joints):
        items += [
            Line(points[j : j + 2, 0], points[j : j + 2, 1], style.pick_colour(j + 1), width=3.5, opacity=0.55),
            Points(points[j, :1], points[j, 1:], style.INK, symbol="ring", size=10.0),
            Text(float(points[j, 0]), float(points[j, 1]), style.clean(name, 20)),
        ]
    return items


def _find_common_ranges(found: Sequence[Sequence[Item]]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return common ranges of x and y for all panels, with a margin."""
    drawn = [item for items in found for item in items if isinstance(item, (Line, Points))]
    ranges = []
    for axis in ("x", "y"):
        low, high = style.find_extent([getattr(item, axis) for item in drawn]) or (-1.0, 1.0)
        margin = 0.1 * max(high - low, 1e-3)
        ranges.append((low - margin, high + margin))
    return ranges[0], ranges[1]


def _draw_markers_alone(data: ReportData, planar: LongTable | None) -> Figure | str:
    """Return the markers of the middle frame, for a recording without a chain."""
    if planar is None or not planar.length:
        return f"No markers to draw: {data.why_missing('planar.parquet')}."
    time = float(planar.time[len(planar.time) // 2])
    title = f"measured markers at {time:.2f} s; no chain was recovered"
    items = tuple(_draw_markers(planar, time, None, filled=True))
    return Figure(((Panel(items, title, ALONG, UP, equal=True, height=4.2),),))
