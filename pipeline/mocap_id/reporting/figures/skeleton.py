"""Figures of the skeleton over the markers and how well it fits them, and the view of what the wrist reaches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id.kinematics.joint import fit_circles
from mocap_id.reporting import style
from mocap_id.reporting.figure import Bars, Figure, Item, Key, Line, Panel, Points, Text, arrange_in_lines, project
from mocap_id.reporting.report_data import ReportData, read_positions
from mocap_id.store import LongTable, Table
from mocap_id.store.artefacts import JointStates

ALONG, UP = "x, along the motion (m)", "y, up (m)"


def draw_skeleton(data: ReportData) -> Figure | str:
    """Return stick figure, joint centres, and measured and predicted markers in two postures side by side.

    A recording without a chain has one panel with the markers of its middle frame.
    """
    skeleton, motion, planar = data.skeleton, data.motion, data.long("planar.parquet")
    moments = () if motion is None else choose_moments(motion, data.table("events.parquet"))
    if skeleton is None or motion is None or not moments:
        if planar is None or not planar.length:
            return f"No markers to draw: {data.why_missing('planar.parquet')}."
        time = float(planar.time[len(planar.time) // 2])
        title = f"measured markers at {time:.2f} s; no chain was recovered"
        items = tuple(_draw_markers(planar, time, {}, filled=True))
        return Figure(((Panel(items, title, ALONG, UP, equal=True, height=4.2),),))
    found, drawn = [], []
    for name, sample in moments:
        time = float(motion.time[sample])
        angle, origin = segment_poses(motion.angles[sample], skeleton.centres)
        points = np.vstack([origin[1:], origin[-1] + rotate(angle[-1], skeleton.tip)])
        sticks: list[Item] = []
        for j, joint in enumerate(skeleton.joints):  # the last stick ends at the centroid of its segment's markers
            sticks += [
                Line(points[j : j + 2, 0], points[j : j + 2, 1], style.pick_colour(j + 1), width=3.5, opacity=0.55),
                Points(points[j, :1], points[j, 1:], style.INK, symbol="ring", size=10.0),
                Text(float(points[j, 0]), float(points[j, 1]), style.clean(joint, 20)),
            ]
        items = (
            *_draw_markers(planar, time, data.segment_of, filled=True),
            *_draw_markers(data.long("markers.parquet"), time, data.segment_of, filled=False),
            *sticks,
        )
        drawn += [item for item in items if isinstance(item, (Line, Points))]
        found.append((f"{name}, {time:.2f} s", items))
    ranges = []  # common to all panels, with a margin
    for axis in ("x", "y"):
        low, high = style.find_extent([getattr(item, axis) for item in drawn]) or (-1.0, 1.0)
        margin = 0.1 * max(high - low, 1e-3)
        ranges.append((low - margin, high + margin))
    across, up = ranges
    return Figure(
        (tuple(Panel(items, title, ALONG, UP, across, up, equal=True, height=4.6) for title, items in found),)
    )


def choose_moments(motion: JointStates, events: Table | None) -> tuple[tuple[str, int], ...]:
    """Return name and sample of two postures: before the rise and standing, or else the two extremes of the motion.

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
            return ("before the rise", nearest[0]), ("standing", nearest[1])
    angles = motion.angles[usable]
    centred = angles - angles.mean(axis=0)
    along = centred @ np.linalg.eigh(centred.T @ centred)[1][:, -1]
    ends = sorted({int(usable[along.argmin()]), int(usable[along.argmax()])})
    return tuple((f"extreme posture {k + 1}", sample) for k, sample in enumerate(ends))


def _draw_markers(table: LongTable | None, time: float, segment_of: Mapping[str, int], *, filled: bool) -> list[Item]:
    """Return the markers in the frame nearest to ``time``, coloured by segment; dots if ``filled``, else rings."""
    if table is None or not table.length:
        return []
    frame = int(np.abs(table.time - time).argmin())
    x, y = table.values["x"][frame], table.values["y"][frame]
    segment = np.array([segment_of.get(label, -1) for label in table.labels])
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
    for j, joint in enumerate(skeleton.joints):
        own, colour = measured[:, skeleton.marker_segment == j + 1], style.pick_colour(j + 1)
        # in the frame of the previous segment: paths of the markers, centres of their circles near the joint, the joint
        points = rotate(-angle[:, j, None], own - origin[:, j, None])
        circles = fit_circles(points[..., 0] + 1j * points[..., 1])
        centre = circles[np.isfinite(circles)]
        reach = float(np.nanmax(np.linalg.norm(points - skeleton.centres[j], axis=-1), initial=0.0))
        near = centre[np.abs(centre - complex(*skeleton.centres[j])) < reach]
        centres = Points(near.real, near.imag, style.INK, "circle centre of one marker", "+", 5.0)
        title = f"{style.clean(joint, 14)} in frame of {style.clean(skeleton.segments[j], 14)}"
        items: tuple[Item, ...] = (_draw_tracks(points, colour), centres, _draw_joint(skeleton.centres[j]))
        before.append(Panel(items, title, "x (m)", "y (m)", equal=True, height=2.8))
        # in the frame of the own segment, with the joints at both ends
        points = rotate(-angle[:, j + 1, None], own - origin[:, j + 1, None])
        local = skeleton.local[skeleton.marker_segment == j + 1]
        ends = [np.zeros(2), *skeleton.centres[j + 1 : j + 2]]
        items = (
            _draw_tracks(points, colour),
            Points(local[:, 0], local[:, 1], style.INK, "marker of the chain", "ring", 4.0),
            *(_draw_joint(end) for end in ends),
        )
        title = f"{style.clean(skeleton.segments[j + 1], 14)} in own frame"
        itself.append(Panel(items, title, "x (m)", "y (m)", equal=True, height=2.8))
    lines = (arrange_in_lines(tuple(panels), _JOINT_COLUMNS) for panels in (before, itself))
    return Figure(tuple(line for pair in zip(*lines, strict=True) for line in pair))


def _draw_tracks(points: FloatArray, colour: str) -> Line:
    """Return the paths of all markers as one line that is interrupted between two markers."""
    broken = np.concatenate([points, np.full_like(points[:1], np.nan)])
    x, y = broken.swapaxes(0, 1).reshape(-1, 2).T
    return Line(x, y, colour, width=1.0, opacity=0.8)


def _draw_joint(centre: FloatArray) -> Points:
    return Points(centre[:1], centre[1:], style.INK, "joint", "ring", 9.0)


_MARKER_ROW = 0.155  # inches per marker
_MOST_MARKERS = 80  # markers in the figure; the table lists all


def draw_residuals(data: ReportData) -> Figure | str:
    """Return a bar for each of the largest residuals, grouped by segment; within a group, the largest is first."""
    found = [
        (label, data.segment_of.get(label, -1), one) for label, one in data.residuals.items() if np.isfinite(one["rms"])
    ]
    if not found:
        return f"No residuals: {data.why_missing('markers.parquet')}."
    worst = sorted(found, key=lambda row: -row[2]["rms"])[:_MOST_MARKERS]
    of = sorted(worst, key=lambda row: row[1])  # stable: the worst stay first
    rms, q95 = (1e3 * np.array([one[name] for *_, one in of]) for name in ("rms", "q95"))
    rows, colours = np.arange(len(of), dtype=np.float64), tuple(style.pick_colour(segment) for _, segment, _ in of)
    labels, names = tuple(style.clean(label, 24) for label, *_ in of), data.segment_names
    texts = tuple(
        f"{label}: {value:.1f} mm, 95 % {most:.1f}" for label, value, most in zip(labels, rms, q95, strict=True)
    )
    keys = (
        Key(style.pick_colour(k), style.clean(names[k], 20) if 0 <= k < len(names) else "no segment")
        for k in sorted({segment for _, segment, _ in of})
    )
    items: tuple[Item, ...] = (
        *keys,
        Bars(rows, np.zeros(len(of)), rms, colours, names=texts),
        Points(q95, rows, style.INK, "95 % quantile", "|", 6.0),
    )
    title = f"{len(of)} largest residuals of {len(found)} markers" if len(of) < len(found) else ""
    most = (0.0, 1.05 * float(max(rms.max(), q95.max())))
    panel = Panel(items, title, "residual (mm)", x_range=most, rows=labels, height=0.6 + _MARKER_ROW * len(of))
    return Figure(((panel,),))


def make_stick_figure(
    data: ReportData, samples: IntArray
) -> tuple[tuple[int, ...], list[FloatArray], FloatArray, tuple[str, ...]] | None:
    """Return the stick figure at K samples of the poses; None without chain or poses.

    It has the segment of each stick, start and end of each stick, (K, 2, 3), m, and centres, (K, J, 3), m, and names of
    the joints whose centre is known.

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
    return tuple(segments), sticks, origins[:, [1 + j for j in shown]], names


_VIEWS = (
    ("from +z", 0.0, 0.0, "x (m)", "y, up (m)"),
    ("from −x", -np.pi / 2, 0.0, "z (m)", "y, up (m)"),
    ("from above", 0.0, np.pi / 2, "x (m)", "−z (m)"),
)
"""Title, turn and tilt (rad), and axis labels of each view."""


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
    # markers at K instants, (K, M, 3), and the segment of each; -1 without a segment
    segment = np.array([data.segment_of.get(label, -1) for label in planar.labels])
    at = planar.time[np.abs(planar.time[:, None] - time).argmin(axis=0)]
    markers = read_positions(planar, at, tuple(planar.labels), "xyz")
    names = np.array([style.clean(label, 24) for label in planar.labels])
    # the views contain all markers and joints
    points = markers.reshape(-1, 3)
    if sticks is not None:
        points = np.concatenate([points, sticks[2].reshape(-1, 3)])
    points = points[np.isfinite(points).all(axis=1)]
    middle, half = np.zeros(3), 1.0
    if len(points):
        low, high = points.min(axis=0), points.max(axis=0)
        middle, half = (low + high) / 2, 0.58 * max(float((high - low).max()), 1e-3)
    lines = []
    for k, moment in enumerate(time):
        panels: list[Panel] = []
        for view, turn, tilt, x, y in _VIEWS:
            items: list[Item] = []
            for number in np.unique(segment).tolist():
                known = (segment == number) & np.isfinite(markers[k]).all(axis=1)
                look: Any = {"symbol": "x" if number < 0 else "dot", "size": 3.2, "names": tuple(names[known].tolist())}
                x_seen, y_seen = project(markers[k, known], turn, tilt).T
                items.append(Points(x_seen, y_seen, style.pick_colour(number), **look))
            if sticks is not None:
                numbers, drawn, joints, called = sticks
                for number, ends in zip(numbers, drawn, strict=True):
                    name, colour = style.clean(data.segment_names[number], 20), style.pick_colour(number)
                    x_seen, y_seen = project(ends[k], turn, tilt).T
                    items.append(Line(x_seen, y_seen, colour, name, width=3.5, opacity=0.55))
                look = {"symbol": "ring", "size": 9.0, "names": tuple(style.clean(name, 24) for name in called)}
                x_seen, y_seen = project(joints[k], turn, tilt).T
                items.append(Points(x_seen, y_seen, style.INK, **look))
            title = view if panels else f"{moment:.2f} s, {view}"
            across, up = ((float(at - half), float(at + half)) for at in project(middle, turn, tilt))
            panels.append(Panel(tuple(items), title, x, y, across, up, equal=True, height=2.9))
        lines.append(tuple(panels))
    return Figure(tuple(lines))


def choose_samples(data: ReportData) -> IntArray | None:
    """Return the indices of the poses at the two extremes of the motion; None without a chain.

    The extremes are the farthest samples along the first principal component of the ends of the sticks.
    """
    poses = data.segment_poses
    if poses is None or not len(poses.time) or not poses.segments:
        return None
    usable = np.flatnonzero(np.isfinite(poses.quaternion).all(axis=(1, 2)) & np.isfinite(poses.origin).all(axis=(1, 2)))
    whole = make_stick_figure(data, usable[:: max(1, len(usable) // 2000)])
    if whole is None or not len(usable) or not whole[1]:
        return None
    usable = usable[:: max(1, len(usable) // 2000)]
    points = np.concatenate(whole[1], axis=1).reshape(len(usable), -1)
    centred = points - points.mean(axis=0)
    along = centred @ np.linalg.eigh(centred.T @ centred)[1][:, -1]
    return np.unique(usable[[along.argmin(), along.argmax()]])


_VIEW = (60.0, 15.0)  # degrees; from the front, on the side of the right arm
_SETS = {"box_m": ("box of independent limits", style.FAINT, 0.45), "visited_m": ("visited region", style.BLUE, 0.8)}
_EVERY = 2  # every second line of longitude is drawn


def draw_reach(data: ReportData) -> Figure | str:
    """Return the surface of the reachable set with the shoulder in the middle, or a sentence if there is none."""
    facts = data.facts("events.parquet").get("reach")
    if facts is None:
        return "No reachable set to draw: only `protocol: reach` has one."
    if not facts.get("mesh"):
        return f"No reachable set to draw: {facts.get('why')}."
    mesh, view, items = facts["mesh"], facts.get("view") or {}, []

    def draw_line(points: FloatArray, colour: str, label: str, *, width: float, opacity: float) -> Line:
        x, y, z = points.T
        return Line(x, y, colour, label, width=width, opacity=opacity, z=z)

    for name, (label, colour, opacity) in _SETS.items():
        if name in mesh:
            lines = make_wires(mesh["theta_deg"], mesh["psi_deg"], mesh[name])
            items.append(draw_line(lines, colour, label, width=0.7, opacity=opacity))
    if view.get("path_m"):
        items.append(draw_line(np.array(view["path_m"]), style.ORANGE, "path of the wrist", width=0.9, opacity=0.8))
    for k, label in enumerate(("upper arm", "forearm")):
        ends = np.array(view["arm_m"])[k : k + 2]
        items.append(draw_line(ends, style.pick_colour(k + 1), label, width=4.0, opacity=0.8))
    x, y, z = np.array(list(view["targets_m"].values())).T
    names = tuple(name.replace("_", " ") for name in view["targets_m"])
    targets = Points(x, y, style.INK, "parts of the body", "x", 5.0, names=names, z=z)
    return Figure(((make_turnable_panel([*items, targets], 1.02 * float(facts["arm_length_m"]), "", 5.6),),))


def make_turnable_panel(items: list[Item], half: float, title: str, height: float) -> Panel:
    """Return a panel whose view the reader can rotate, first from the front; its ranges are ± ``half``, m."""
    ends = (-half, half)
    axes = ("across the view (m)", "up the view (m)", ends, ends)
    return Panel(tuple(items), title, *axes, equal=True, height=height, view=_VIEW)


def make_wires(polar: Sequence[float], azimuth: Sequence[float], radii: Sequence[Sequence[float | None]]) -> FloatArray:
    """Return the circles of latitude and every second line of longitude of a surface as one line (K, 3), with NaN gaps.

    ``polar`` (N,) and ``azimuth`` (M,) are the angles of the N x M points, degrees, and ``radii`` their radii, m.
    """
    theta, psi = np.radians(polar)[:, None], np.radians(azimuth)
    radius = np.array(radii, dtype=np.float64)
    along = np.broadcast_to(np.cos(theta), radius.shape)
    points = radius[..., None] * np.stack([np.sin(theta) * np.sin(psi), along, np.sin(theta) * np.cos(psi)], axis=-1)
    gap = np.full((1, 3), np.nan)
    rows = [np.concatenate([row, row[:1], gap]) for row in points]
    columns = [np.concatenate([points[:, k], gap]) for k in range(0, len(psi), _EVERY)]
    return np.concatenate([*rows, *columns])
