"""Chain in space over the markers: its stick figure, and three views at two instants."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Figure, Item, Line, Panel, Points, project
from mocap_id.reporting.markers import read_positions
from mocap_id.reporting.report_data import ReportData


@dataclass(frozen=True)
class StickFigure:
    """Sticks and joints of the chain in K samples; joints whose centre is unknown are left out."""

    segments: tuple[int, ...]  # segment of each stick
    sticks: tuple[FloatArray, ...]  # (K, 2, 3) start and end of each stick, m
    joints: FloatArray  # (K, J, 3) centres of the joints, m
    names: tuple[str, ...]  # names of the joints


def make_stick_figure(data: ReportData, samples: IntArray) -> StickFigure | None:
    """Return the stick figure at some samples of the poses; None without chain or poses.

    A stick leads from the joint of a segment to each next joint, or to the centroid of its markers if there is none. It
    begins at this centroid if the segment is the base, or if the centre of its joint is unknown.
    """
    skeleton, poses = data.spatial_skeleton, data.segment_poses
    if skeleton is None or poses is None or len(poses.segments) != len(skeleton.segments):
        return None
    chain = skeleton.chain
    known = [False, *(joint.known for joint in chain.joints)]
    tips = [poses.locate_points(k, skeleton.locate_tip(k)[None])[samples, 0] for k in range(len(known))]
    origins = poses.origin[samples]
    segments, sticks = [], []
    for k, tip in enumerate(tips):
        start = origins[:, k] if known[k] else tip
        ends = [origins[:, 1 + j] for j, parent in enumerate(chain.parents) if parent == k and known[1 + j]]
        for end in ends or ([tip] if known[k] else []):
            segments.append(k)
            sticks.append(np.stack([start, end], axis=1))
    shown = [j for j, joint in enumerate(chain.joints) if joint.known]
    names = tuple(skeleton.joints[j] for j in shown)
    return StickFigure(tuple(segments), tuple(sticks), origins[:, [1 + j for j in shown]], names)


_VIEWS = (
    ("from +z", 0.0, 0.0, "x (m)", "y, up (m)"),
    ("from −x", -np.pi / 2, 0.0, "z (m)", "y, up (m)"),
    ("from above", 0.0, np.pi / 2, "x (m)", "−z (m)"),
)
"""Title, turn and tilt (rad), and axis labels of each view."""


@dataclass(frozen=True)
class _Scene:
    """Markers by segment and stick figure at K instants."""

    time: FloatArray  # (K,)
    segments: tuple[str, ...]
    markers: list[tuple[int, FloatArray, tuple[str, ...]]]  # segment, (K, m, 3), names
    sticks: StickFigure | None

    def extent(self) -> tuple[FloatArray, float]:
        """Return the middle (3,) of all markers and joints, and half the width of a view that contains them, m."""
        seen = [values.reshape(-1, 3) for _, values, _ in self.markers]
        if self.sticks is not None:
            seen.append(self.sticks.joints.reshape(-1, 3))
        points = np.concatenate(seen)
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            return np.zeros(3), 1.0
        low, high = points.min(axis=0), points.max(axis=0)
        return (low + high) / 2, 0.58 * max(float((high - low).max()), 1e-3)

    def items(self, k: int, turn: float, tilt: float) -> Iterator[Item]:
        """Yield the items of a view at instant ``k``; ``turn`` and ``tilt`` are in rad."""
        for segment, values, names in self.markers:
            known = np.isfinite(values[k]).all(axis=1)
            shown = tuple(name for name, one in zip(names, known, strict=True) if one)
            look: Any = {"symbol": "x" if segment < 0 else "dot", "size": 3.2, "names": shown}
            across, up = project(values[k, known], turn, tilt).T
            yield Points(across, up, style.pick_colour(segment), **look)
        if self.sticks is None:
            return
        for segment, ends in zip(self.sticks.segments, self.sticks.sticks, strict=True):
            across, up = project(ends[k], turn, tilt).T
            name = style.clean(self.segments[segment], 20)
            yield Line(across, up, style.pick_colour(segment), name, width=3.5, opacity=0.55)
        across, up = project(self.sticks.joints[k], turn, tilt).T
        names = tuple(style.clean(name, 24) for name in self.sticks.names)
        yield Points(across, up, style.INK, symbol="ring", size=9.0, names=names)


def draw(data: ReportData) -> Figure | str:
    """Return sticks, joint centres and markers in three views, for the two extremes of the motion."""
    planar = data.long("planar.parquet")
    if planar is None or not planar.length:
        return f"No markers to draw: {data.why_missing('planar.parquet')}."
    samples = choose_samples(data)
    if samples is None or data.segment_poses is None:
        time, sticks = planar.time[[len(planar.time) // 2]], None
    else:
        time, sticks = data.segment_poses.time[samples], make_stick_figure(data, samples)
    scene = _Scene(time, data.segment_names, _collect_markers(data, time), sticks)
    return Figure(tuple(_draw_views(scene, k) for k in range(len(time))))


def _draw_views(scene: _Scene, k: int) -> tuple[Panel, ...]:
    """Return the panels of all views at instant ``k``."""
    middle, half = scene.extent()
    panels: list[Panel] = []
    for view, turn, tilt, x, y in _VIEWS:
        title = view if panels else f"{scene.time[k]:.2f} s, {view}"
        across, up = ((float(at - half), float(at + half)) for at in project(middle, turn, tilt))
        items = tuple(scene.items(k, turn, tilt))
        panels.append(Panel(items, title, x, y, across, up, equal=True, height=2.9))
    return tuple(panels)


def choose_samples(data: ReportData) -> IntArray | None:
    """Return the indices of the poses at the two extremes of the motion; None without a chain.

    The extremes are the farthest samples along the first principal component of the ends of the sticks.
    """
    poses = data.segment_poses
    if poses is None or not len(poses.time) or not poses.segments:
        return None
    usable = np.flatnonzero(np.isfinite(poses.quaternion).all(axis=(1, 2)) & np.isfinite(poses.origin).all(axis=(1, 2)))
    whole = make_stick_figure(data, usable[:: max(1, len(usable) // 2000)])
    if whole is None or not len(usable) or not whole.sticks:
        return None
    usable = usable[:: max(1, len(usable) // 2000)]
    points = np.concatenate(whole.sticks, axis=1).reshape(len(usable), -1)
    centred = points - points.mean(axis=0)
    along = centred @ np.linalg.eigh(centred.T @ centred)[1][:, -1]
    return np.unique(usable[[along.argmin(), along.argmax()]])


def _collect_markers(data: ReportData, times: FloatArray) -> list[tuple[int, FloatArray, tuple[str, ...]]]:
    """Return segment number, positions (K, m, 3), m, and names of the markers, one entry for each segment.

    The number is -1 for markers without a segment.
    """
    planar, skeleton = data.long("planar.parquet"), data.spatial_skeleton
    assert planar is not None
    own = {} if skeleton is None else dict(zip(skeleton.markers, skeleton.marker_segment.tolist(), strict=True))
    segment = np.array([own.get(label, -1) for label in planar.labels])
    at = planar.time[np.abs(planar.time[:, None] - times).argmin(axis=0)]
    values = read_positions(planar, at, tuple(planar.labels), "xyz")
    names = np.array([style.clean(label, 24) for label in planar.labels])
    return [(k, values[:, segment == k], tuple(names[segment == k].tolist())) for k in np.unique(segment).tolist()]
