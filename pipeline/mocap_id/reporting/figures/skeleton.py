"""Figures of the skeleton over the markers, in the plane and in space, and of how well it fits them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id.kinematics.joint import fit_circles
from mocap_id.reporting import style
from mocap_id.reporting.figure import Bars, Figure, Item, Key, Line, Panel, Points, Text, arrange_in_lines, project
from mocap_id.reporting.report_data import ReportData, read_positions
from mocap_id.store import LongTable, Table
from mocap_id.store.views import JointStates, Skeleton

ALONG, UP = "x, along the motion (m)", "y, up (m)"


@dataclass(frozen=True)
class Moment:
    """The index of a sample of the states, and the name of the posture in it."""

    name: str
    sample: int


def draw_skeleton(data: ReportData) -> Figure | str:
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


_MOMENTS = 150
_JOINT_COLUMNS = 4


def draw_recovery(data: ReportData) -> Figure | str:
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
    lines = (arrange_in_lines(tuple(panels), _JOINT_COLUMNS) for panels in (before, itself))
    pairs = zip(*lines, strict=True)
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


_MARKER_ROW = 0.155  # inches per marker
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
    panel = Panel(items, title, "residual (mm)", x_range=most, rows=labels, height=0.6 + _MARKER_ROW * len(of))
    return Figure(((panel,),))


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


def draw_spatial_skeleton(data: ReportData) -> Figure | str:
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
