"""The recovered chain over the markers at two moments (figure 6.2, left)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id.reporting import style
from mocap_id.reporting.material import Material
from mocap_id.reporting.views import Motion, Skeleton


@dataclass(frozen=True)
class Moment:
    """A sample worth drawing."""

    name: str
    sample: int


def draw(material: Material) -> Figure | str:
    """Stick figure, joint centres, markers as measured and as predicted, side by side for two postures."""
    skeleton, motion, planar = material.skeleton, material.motion, material.frame("planar.parquet")
    moments = () if motion is None else two_moments(motion, material.frame("events.parquet"))
    if skeleton is None or motion is None or not moments:
        return _markers_alone(material, planar)
    figure = style.figure(4.8)
    figure.set_layout_engine("constrained", h_pad=0.15)  # a fixed aspect takes a little more room than is reserved
    columns = figure.subplots(1, len(moments), sharex=True, sharey=True, squeeze=False)[0]
    for axes, moment in zip(columns, moments, strict=True):
        time = float(motion.time[moment.sample])
        _markers(axes, _at(planar, time), skeleton, filled=True)
        _markers(axes, _at(material.frame("markers.parquet"), time), skeleton, filled=False)
        _sticks(axes, skeleton, motion.angles[moment.sample])
        _finish(axes, f"{moment.name}, {time:.2f} s")
    columns[0].set_ylabel("y, up (m)")
    return figure


def two_moments(motion: Motion, events: pd.DataFrame | None) -> tuple[Moment, ...]:
    """The two postures to show: seated and standing where a repetition has both, else the two extremes of the motion.

    The extremes are the farthest samples along the first principal component of the angles, among those where every
    joint was observed. None where no sample has every angle.
    """
    known = ~np.isnan(motion.angles.sum(axis=1))
    seen = known & (motion.observed.sum(axis=1) == motion.observed.shape[1])
    usable = np.flatnonzero(seen if seen.any() else known)
    if not len(usable):
        return ()
    if events is not None:
        whole = events[["start", "stand"]].to_numpy(dtype=np.float64)
        whole = whole[np.isfinite(whole.sum(axis=1))]
        if len(whole):
            nearest = [int(usable[np.abs(motion.time[usable] - time).argmin()]) for time in whole[0]]
            return Moment("before the rise", nearest[0]), Moment("standing", nearest[1])
    angles = motion.angles[usable]
    centred = angles - angles.mean(axis=0)
    along = centred @ np.linalg.eigh(centred.T @ centred)[1][:, -1]
    ends = sorted({int(usable[along.argmin()]), int(usable[along.argmax()])})
    return tuple(Moment(f"extreme posture {k + 1}", sample) for k, sample in enumerate(ends))


def _at(frame: pd.DataFrame | None, time: float) -> pd.DataFrame:
    """The rows of the long table at the frame nearest to this time; the table is sorted by time."""
    if frame is None or frame.empty:
        return pd.DataFrame({"marker": [], "x": [], "y": []})
    clock = frame["time"].to_numpy(dtype=np.float64)
    after = min(int(np.searchsorted(clock, time)), len(clock) - 1)
    nearest = min(clock[max(after - 1, 0)], clock[after], key=lambda candidate: abs(candidate - time))
    return frame.iloc[np.searchsorted(clock, nearest) : np.searchsorted(clock, nearest, side="right")]


def _segment_of(labels: list[str], skeleton: Skeleton | None) -> IntArray:
    """Segment of each label, -1 for those without one."""
    known = {} if skeleton is None else dict(zip(skeleton.markers, skeleton.marker_segment.tolist(), strict=True))
    return np.array([known.get(label, -1) for label in labels], dtype=np.int64)


def _markers(axes: Axes, rows: pd.DataFrame, skeleton: Skeleton | None, *, filled: bool) -> None:
    """Markers coloured by segment: dots where measured, rings where predicted."""
    position = rows[["x", "y"]].to_numpy(dtype=np.float64)
    segment = _segment_of(rows["marker"].astype(str).tolist(), skeleton)
    for k in np.unique(segment).tolist():
        x, y = position[segment == k].T
        colour = style.colour(max(k, 0))
        marker = "x" if k < 0 else "o"
        face = colour if filled else "none"
        axes.plot(x, y, marker, ms=3 if filled else 5.5, mfc=face, mec=colour, mew=0.6 if filled else 0.8, zorder=3)


def _sticks(axes: Axes, skeleton: Skeleton, angles: FloatArray) -> None:
    """One line per moving segment, from its joint to the next (the last one to the middle of its markers)."""
    angle, origin = segment_poses(angles, skeleton.centres)
    tip = origin[-1] + rotate(angle[-1], skeleton.tip)
    points = np.vstack([origin[1:], tip])
    for j in range(len(skeleton.joints)):
        axes.plot(*points[j : j + 2].T, color=style.colour(j + 1), lw=3.5, alpha=0.55, solid_capstyle="round")
        axes.plot(*points[j], "o", ms=10, mfc="none", mec=style.INK, mew=1.2, zorder=4)
        label = style.printable(skeleton.joints[j], 20)
        axes.annotate(label, points[j], (9, -3), textcoords="offset points", fontsize=7.5, color=style.INK)


def _finish(axes: Axes, title: str) -> None:
    axes.margins(0.12)
    axes.set_aspect("equal")
    axes.set(title=title, xlabel="x, along the motion (m)")


def _markers_alone(material: Material, planar: pd.DataFrame | None) -> Figure | str:
    """Without a chain: the markers of the middle frame, so that the reader sees what the recording holds."""
    if planar is None or planar.empty:
        return f"No markers to draw: {material.why_missing('planar.parquet')}."
    figure = style.figure(4.2)
    axes = figure.subplots()
    time = float(planar["time"].iloc[len(planar) // 2])
    _markers(axes, _at(planar, time), None, filled=True)
    _finish(axes, f"markers as measured, {time:.2f} s: no chain was recovered")
    axes.set_aspect("equal", adjustable="datalim")  # no second panel to share the axes with: use the width
    axes.set_ylabel("y, up (m)")
    return figure
