"""Player of a trial in space: stick figure and markers in a view that the reader can rotate, and curves over time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.reporting import style
from mocap_id.reporting.figure import Line, Panel
from mocap_id.reporting.figures import wrench
from mocap_id.reporting.markers import read_positions
from mocap_id.reporting.player import LOW, Part, Player, choose_frame_times, find_bounds, make_marker_parts, make_stick
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.space.figures.angles import collect_joint_motions
from mocap_id.reporting.space.figures.skeleton import make_stick_figure

MOST = 600
"""Maximum number of frames."""
_CELLS = 4  # number of cells of the floor in each direction
_AXES = {"x": style.VERMILLION, "y, up": style.GREEN, "z": style.BLUE}


def make_spatial_player(data: ReportData) -> Player | None:
    """Return the player of a trial in space; None without markers or with fewer than two frames."""
    planar = data.long("planar.parquet")
    if planar is None or not len(planar.labels):
        return None
    time = choose_frame_times(planar.time, len(planar.labels), MOST)
    if len(time) < 2:
        return None
    labels = tuple(str(label) for label in planar.labels)
    moving = [*_make_chain(data, time), *make_marker_parts(data, labels, read_positions(planar, time, labels, "xyz"))]
    curves = (
        *(one.draw_panel(0, LOW) for one in collect_joint_motions(data)),
        *(panel for panel in wrench.draw_panels(data, LOW) if any(isinstance(item, Line) for item in panel.items)),
    )
    return Player(time, (*_make_floor(find_bounds(moving), len(time)), *moving), _label_time(curves), None, "")


def _label_time(curves: tuple[Panel, ...]) -> tuple[Panel, ...]:
    """Return the panels of curves; the last has a label for the time axis."""
    if not curves or curves[-1].x:
        return curves
    return (*curves[:-1], replace(curves[-1], x="time (s)", height=LOW + 0.3))


def _make_chain(data: ReportData, time: FloatArray) -> list[Part]:
    """Return the sticks and joints of the chain at the times (K,) of the frames; empty without poses."""
    poses = data.segment_poses
    if poses is None or not len(poses.time):
        return []
    samples = np.searchsorted(poses.time, time - 1e-9).clip(0, len(poses.time) - 1)
    found = make_stick_figure(data, samples)
    if found is None:
        return []
    away = np.abs(poses.time[samples] - time) > np.median(np.diff(poses.time)) if len(poses.time) > 1 else samples > 0
    parts = []
    for segment, ends in zip(found.segments, found.sticks, strict=True):
        parts.append(make_stick(segment, data.segment_names[segment], _hide_missing(ends, away)))
    look = {"colour": style.INK, "symbol": "ring", "size": 10.0}
    return [*parts, Part("joints", look, _hide_missing(found.joints, away))]


def _hide_missing(points: FloatArray, away: BoolArray) -> FloatArray:
    """Return points (K, P, 3) as (K, 3, P); NaN in the frames in which ``away`` (K,) is true."""
    return np.where(away[:, None, None], np.nan, points).swapaxes(1, 2)


def _make_floor(found: FloatArray, frames: int) -> list[Part]:
    """Return a grid below the markers, and the axes of the trial's coordinate frame at a corner of the grid.

    ``found`` (3, 2) contains minimum and maximum of each coordinate, m. The parts are the same in all frames.
    """
    low, high = found[:, 0], found[:, 1]
    wide = max(float((high - low)[[0, 2]].max()), 0.1)
    corner = np.array([(low + high)[0] / 2 - wide / 2, low[1], (low + high)[2] / 2 - wide / 2])
    steps = np.linspace(0.0, wide, _CELLS + 1)
    gap = np.full(3, np.nan)
    rows = []
    for along, across in ((0, 2), (2, 0)):
        for step in steps:
            start = corner + step * np.eye(3)[across]
            rows += [start, start + wide * np.eye(3)[along], gap]
    parts = [Part("floor", {"colour": style.GRID, "width": 0.6}, _repeat_in_frames(np.array(rows), frames))]
    for axis, (name, colour) in enumerate(_AXES.items()):
        ends = np.array([corner, corner + 0.2 * wide * np.eye(3)[axis]])
        parts.append(Part("axis", {"colour": colour, "label": name, "width": 1.6}, _repeat_in_frames(ends, frames)))
    return parts


def _repeat_in_frames(points: FloatArray, frames: int) -> FloatArray:
    """Return points (P, 3) repeated for every frame, (frames, 3, P)."""
    return np.repeat(points.T[None], frames, axis=0)
