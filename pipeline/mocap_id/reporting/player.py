"""Player of the page: an animated stick figure, and curves over time with a line at the current time."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id.reporting import style
from mocap_id.reporting.figure import Figure, Line, Panel, Points, Rule, to_json
from mocap_id.reporting.figures.motion import (
    draw_joint_panels,
    draw_panel,
    draw_panels,
    label_angle,
    label_joints,
    read_forces,
)
from mocap_id.reporting.figures.skeleton import ALONG, UP, make_stick_figure
from mocap_id.reporting.report_data import ReportData, read_positions

RATE = 30.0
"""Maximum number of frames per second."""
MOST = 1800
"""Maximum number of frames: a minute at :data:`RATE`; longer recordings have longer time steps."""
MOST_IN_SPACE = 600
"""Maximum number of frames of a trial in space."""
_VALUES = 900_000
"""Maximum number of values in all frames together, which are 2.4 MB as text."""
_UNKNOWN = -32768
_REACH = 0.45  # length of the largest force arrow as a fraction of the figure's height
TALL, LOW = 5.9, 1.12  # heights of the stick figure and of each panel of curves, inches
TALL_IN_SPACE = 4.4
_SHAPE = 0.54  # width divided by height of the figure
_CELLS = 4  # number of cells of the floor in each direction
_JOINTS = {"colour": style.INK, "symbol": "ring", "size": 10.0}
_AXES = {"x": style.VERMILLION, "y, up": style.GREEN, "z": style.BLUE}
ACROSS, UPWARDS = "across the view (m)", "up the view (m)"


@dataclass(frozen=True)
class Part:
    """Lines or points with a common style, and their coordinates in K frames, (K, 2 or 3, points), m."""

    name: str
    look: Mapping[str, Any]
    values: FloatArray

    @property
    def item(self) -> Line | Points:
        """The part in the first frame, as an item of a panel."""
        made = Points if "symbol" in self.look else Line
        return made(*self.values[0, :2], **self.look)


@dataclass(frozen=True)
class Player:
    """Moving parts in K frames, and curves over time."""

    time: FloatArray  # (K,) times of the frames, s
    parts: tuple[Part, ...]
    curves: tuple[Panel, ...]  # angles, wrench and centre of pressure; empty if none is known
    newton_per_metre: float | None  # force of an arrow of one metre, N; None without forces
    motion: str  # sentence on the motion that stick figure and model use; empty if nothing was identified

    def to_json(self) -> Mapping[str, Any]:
        """Return figure, curves and frames as JSON values.

        Frames are 16-bit integers, one row for each frame, with the coordinates of all parts in units of ``step``, m.
        In space the page rotates the coordinates about ``centre`` and projects them.
        """
        rows = np.concatenate([part.values.reshape(len(self.time), -1) for part in self.parts], axis=1)
        known = np.isfinite(rows)
        step = max(float(np.abs(rows[known]).max(initial=0.0)), 1e-6) / 32767
        whole = np.where(known, np.round(np.where(known, rows, 0.0) / step), _UNKNOWN).astype("<i2")
        curves = Figure(tuple((panel,) for panel in self.curves))
        found, items = find_bounds(self.parts), tuple(part.item for part in self.parts)
        if self.in_space:  # the ranges contain the bounds from any side
            half = np.ptp(found, axis=1) / 2
            side = 1.04 * max(float(np.hypot(half[0], half[2])), float(np.linalg.norm(half)), 1e-3)
            ends = (-side, side)
            panel = Panel(items, x=ACROSS, y=UPWARDS, x_range=ends, y_range=ends, equal=True, height=TALL_IN_SPACE)
        else:  # the ranges contain the bounds and the ground, with the aspect ratio of the player
            low, high = np.minimum(found[:, 0], [np.inf, 0.0]), np.maximum(found[:, 1], [-np.inf, 0.0])
            shape = np.array([_SHAPE, 1.0])
            half = 0.56 * max(float(np.max((high - low) / shape)), 1e-3) * shape
            (left, below), (right, above) = (0.5 * (low + high) - half).tolist(), (0.5 * (low + high) + half).tolist()
            drawn, across, up = (Rule("y", 0.0, style.FAINT), *items), (left, right), (below, above)
            panel = Panel(drawn, x=ALONG, y=UP, x_range=across, y_range=up, equal=True, height=TALL)
        return {
            "figure": to_json(Figure(((panel,),))),
            "curves": to_json(curves) if self.curves else None,
            "time": [round(float(moment), 4) for moment in self.time],
            "values": base64.b64encode(whole.tobytes()).decode("ascii"),
            "step": step,
            "unknown": _UNKNOWN,
            "rows": [part.values.shape[2] for part in self.parts],
            **({"centre": found.mean(axis=1).tolist()} if self.in_space else {}),
        }

    @property
    def in_space(self) -> bool:
        """Whether the parts have three coordinates, so that the reader can rotate the view."""
        return any(part.values.shape[1] == 3 for part in self.parts)


def make_player(data: ReportData) -> Player | None:
    """Return the player of a trial in the plane or in space; None without markers or with fewer than two frames."""
    planar, in_space = data.long("planar.parquet"), data.in_space
    if planar is None or not len(planar.labels):
        return None
    time = choose_frame_times(planar.time, len(planar.labels), MOST_IN_SPACE if in_space else MOST)
    if len(time) < 2:
        return None
    # the markers of each segment as dots, and the markers without a segment as crosses
    labels = tuple(str(label) for label in planar.labels)
    values = read_positions(planar, time, labels, "xyz" if in_space else "xy")
    segments = np.array([data.segment_of.get(label, -1) for label in labels])
    markers = []
    for k in np.unique(segments).tolist():
        own = np.flatnonzero(segments == k)
        names = tuple(style.clean(labels[i], 24) for i in own)
        look = {"colour": style.pick_colour(k), "symbol": "x" if k < 0 else "dot", "size": 3.7, "names": names}
        markers.append(Part("markers", look, values[:, own].swapaxes(1, 2)))
    wrench = [panel for panel in draw_panels(data, LOW) if any(isinstance(item, Line) for item in panel.items)]
    if in_space:
        moving = [*_make_spatial_chain(data, time), *markers]
        curves = [*(panel for (panel,) in draw_joint_panels(data, (0,), LOW)), *wrench]
        if curves and not curves[-1].x:
            curves[-1] = replace(curves[-1], x="time (s)", height=LOW + 0.3)
        return Player(time, (*_make_floor(find_bounds(moving), len(time)), *moving), tuple(curves), None, "")
    motion, skeleton, moving = data.motion, data.skeleton, markers
    if skeleton is not None and motion is not None and len(motion.time):
        # sticks from joint to joint and to the centroid of the last segment's markers
        angle, origin = segment_poses(motion.angles[_find_nearest(motion.time, time)], skeleton.centres)
        tip = origin[:, -1] + rotate(angle[:, -1], skeleton.tip)
        points = np.concatenate([origin[:, 1:], tip[:, None]], axis=1).swapaxes(1, 2)  # (K, 2, n + 1)
        sticks = [_make_stick(j + 1, name, points[..., j : j + 2]) for j, name in enumerate(skeleton.joints)]
        moving = [*sticks, Part("joints", _JOINTS, points[..., :-1]), *markers]
    scale, forces = _make_forces(data, time, float(np.ptp(find_bounds(moving)[1])))
    motion, about = data.shown_motion, ""
    if motion is not None and motion.mean.size:
        wrench.insert(0, draw_panel(motion, 0, label_joints(data), LOW, label_angle(data)))
    if data.measured_poses:
        about = "The stick figure is the pinned chain; the modelled forces use the measured poses."
    elif data.facts("dynamics.h5").get("motion") is not None:
        about = "Stick figure and model both use the pinned chain."
    return Player(time, (*moving, *forces), tuple(wrench), scale, about)


def find_bounds(parts: Sequence[Part]) -> FloatArray:
    """Return minimum and maximum of each coordinate over all parts except forces, (2 or 3, 2), m, without outliers."""
    seen = [part.values for part in parts if not part.name.startswith("force")]
    points = np.concatenate([values.swapaxes(1, 2).reshape(-1, values.shape[1]) for values in seen])
    points = points[np.isfinite(points).all(axis=1)]
    nothing = np.array([[-1, 1], [0, 2], [-1, 1]])[: points.shape[1]]
    found: FloatArray = np.quantile(points, (0.001, 0.999), axis=0).T if len(points) else nothing
    return found


def choose_frame_times(time: FloatArray, markers: int, most: int) -> FloatArray:
    """Return at most ``most`` evenly spaced sample times of the recording; fewer if there are many ``markers``."""
    if len(time) < 2:
        return time
    wanted = int((time[-1] - time[0]) * RATE) + 1
    count = max(2, min(len(time), wanted, most, _VALUES // (2 * markers + 32)))
    return time[np.unique(np.linspace(0, len(time) - 1, count).round().astype(np.int64))]


def _make_stick(segment: int, name: str, ends: FloatArray) -> Part:
    """Return the stick of a segment between its two ends; ``ends`` (K, 2 or 3, 2) has their coordinates, m."""
    look = {"colour": style.pick_colour(segment), "label": style.clean(name, 20), "width": 5.0, "opacity": 0.6}
    return Part("stick", look, ends)


def _make_forces(data: ReportData, time: FloatArray, height: float) -> tuple[float | None, list[Part]]:
    """Return the scale, N per metre of arrow, and the arrows of the measured and modelled ground reaction force.

    ``height`` is the height of the stick figure, m. Without forces, the scale is None and the list is empty.
    """
    table = read_forces(data)
    if table is None or not table.length:
        return None, []
    row = _find_nearest(table["time"], time)
    found = {
        suffix: table.stack(columns)[row]
        for suffix in ("", "_model")
        if set(columns := [f"{name}{suffix}" for name in ("cop_x", "Fx", "Fy")]) <= set(table.names)
    }
    largest = np.nanmax(np.abs(found[""][:, 2]), initial=0.0) if "" in found else 0.0
    if not largest > 0 or not height > 0:
        return None, []
    scale = float(largest) / (_REACH * height)
    parts = []
    for suffix, force in found.items():
        cop, Fx, Fy = force.T
        start = np.where(np.isfinite(force.sum(axis=1)), 0.0, np.nan)
        arrow = np.moveaxis(np.array([[cop, cop + Fx / scale], [start, start + Fy / scale]]), -1, 0)  # (K, 2, 2)
        colour, label = (style.MODEL, "identified model") if suffix else (style.MEASURED, "measured")
        look = {"colour": colour, "label": label, "width": 1.6 if suffix else 2.2}
        parts += [
            Part(f"force{suffix}", look, arrow),
            Part("force origin", {"colour": colour, "symbol": "dot", "size": 5.0}, arrow[..., :1]),
        ]
    return scale, parts


def _find_nearest(clock: FloatArray, time: FloatArray) -> IntArray:
    """Return the indices (K,) of the samples in ``clock`` (T,) that are nearest to each ``time`` (K,)."""
    after = np.searchsorted(clock, time).clip(1, max(len(clock) - 1, 1))
    before = after - 1
    after = after.clip(0, len(clock) - 1)
    nearer = np.abs(clock[before] - time) <= np.abs(clock[after] - time)
    return np.where(nearer, before, after).astype(np.int64)


def _make_spatial_chain(data: ReportData, time: FloatArray) -> list[Part]:
    """Return the sticks and joints of the chain at the times (K,) of the frames; empty without poses."""
    poses = data.segment_poses
    if poses is None or not len(poses.time):
        return []
    samples = np.searchsorted(poses.time, time - 1e-9).clip(0, len(poses.time) - 1)
    found = make_stick_figure(data, samples)
    if found is None:
        return []
    # no pose is near these frames
    away = np.abs(poses.time[samples] - time) > np.median(np.diff(poses.time)) if len(poses.time) > 1 else samples > 0
    segments, drawn, centres, _ = found
    *sticks, joints = (np.where(away[:, None, None], np.nan, points).swapaxes(1, 2) for points in (*drawn, centres))
    named = zip(segments, sticks, strict=True)
    parts = [_make_stick(segment, data.segment_names[segment], ends) for segment, ends in named]
    return [*parts, Part("joints", _JOINTS, joints)]


def _make_floor(found: FloatArray, frames: int) -> list[Part]:
    """Return a grid below the markers, and the axes of the trial's coordinate frame at a corner of the grid.

    ``found`` (3, 2) contains minimum and maximum of each coordinate, m. The parts are the same in all frames.
    """
    low, high = found[:, 0], found[:, 1]
    wide = max(float((high - low)[[0, 2]].max()), 0.1)
    corner = np.array([(low + high)[0] / 2 - wide / 2, low[1], (low + high)[2] / 2 - wide / 2])
    steps = np.linspace(0.0, wide, _CELLS + 1)
    gap, unit = np.full(3, np.nan), np.eye(3)
    rows = []
    for along, across in ((0, 2), (2, 0)):
        for step in steps:
            start = corner + step * unit[across]
            rows += [start, start + wide * unit[along], gap]
    lines: list[tuple[str, dict[str, Any], list[FloatArray]]] = [("floor", {"colour": style.GRID, "width": 0.6}, rows)]
    for axis, (name, colour) in enumerate(_AXES.items()):
        look = {"colour": colour, "label": name, "width": 1.6}
        lines.append(("axis", look, [corner, corner + 0.2 * wide * unit[axis]]))
    return [Part(name, look, np.repeat(np.array(points).T[None], frames, axis=0)) for name, look, points in lines]
