"""Angles of every joint in space: over time, their derivatives, and phase portraits of curls (thesis 8.6 to 8.9)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import NORMAL_95, BoolArray
from mocap_id.geometry.so3 import shift_to_shortest_arc
from mocap_id.reporting import style
from mocap_id.reporting.downsampling import find_spans
from mocap_id.reporting.figure import Band, Figure, Item, Line, Panel, Spans, arrange_in_lines
from mocap_id.reporting.figures.states import draw_panel
from mocap_id.reporting.report_data import ReportData
from mocap_id.store.spatial_views import MEANINGLESS_AT_POLE, SpatialAngles
from mocap_id.store.views import JointStates

_ANATOMICAL = {"upper_arm": "shoulder", "forearm": "elbow", "hand": "wrist"}
"""Names of the angles of the joints that move these segments."""


@dataclass(frozen=True)
class JointMotion:
    """The angles of one joint with velocities and accelerations."""

    title: str
    names: tuple[str, ...]  # names of the angles
    states: JointStates  # NaN where an angle has no meaning
    near_gimbal: BoolArray  # (T,) samples in which some of the angles have no meaning

    def draw_panel(self, order: int, height: float, *, below: str = "") -> Panel:
        """Return angles, velocities or accelerations (``order`` 0, 1 or 2) over time, with 95 % bands and shades.

        ``below`` is the label of the time axis.
        """
        drawn = draw_panel(self.states, order, self.names, height)
        found = np.array(find_spans(self.states.time, self.near_gimbal)).reshape(-1, 2)
        shade = (Spans(found[:, 0], found.sum(axis=1), style.SKY, 0.25),) if len(found) else ()
        return replace(drawn, items=(*shade, *drawn.items), title=self.title, x=below)


def collect_joint_motions(data: ReportData) -> list[JointMotion]:
    """Return the angles of each joint, and at the end any other angles; empty if nothing was estimated."""
    angles = data.angles
    if angles is None or not angles.names or not len(angles.time):
        return []
    found, left, skeleton = [], list(angles.names), data.spatial_skeleton
    for j, joint in enumerate(() if skeleton is None else skeleton.joints):
        moved = "" if skeleton is None else skeleton.segments[j + 1]
        stems = (f"{_ANATOMICAL.get(moved, joint)}_", f"joint_{j + 1}_")
        own = [name for name in left if name.startswith(stems)]
        left = [name for name in left if name not in own]
        if own:
            found.append(_make_motion(joint, own, angles, _find_observed(data, j)))
    return [*found, _make_motion("other angles", left, angles, _find_observed(data, None))] if left else found


def _make_motion(joint: str, own: list[str], angles: SpatialAngles, observed: BoolArray) -> JointMotion:
    columns = [angles.names.index(name) for name in own]
    mean = angles.mean[:, columns].copy()
    for k, name in enumerate(own):
        usable = angles.find_usable(name)
        if name in MEANINGLESS_AT_POLE and usable.any():
            mean[usable, k, 0] = shift_to_shortest_arc(mean[usable, k, 0])
        mean[~usable, k] = np.nan
    states = JointStates(angles.time, mean, angles.sd[:, columns], np.tile(observed[:, None], (1, len(own))))
    near = angles.near_gimbal & any(name in MEANINGLESS_AT_POLE for name in own)
    names = tuple(style.clean(name.replace("_", " "), 24) for name in own)
    return JointMotion(style.clean(joint.replace("_", " "), 24), names, states, near)


def _find_observed(data: ReportData, joint: int | None) -> BoolArray:
    """Return a mask (T,) of the samples in which both segments of a joint are observed; all true for ``joint`` None."""
    angles, poses, skeleton = data.angles, data.segment_poses, data.spatial_skeleton
    assert angles is not None
    if joint is None or poses is None or skeleton is None or len(poses.time) != len(angles.time):
        return np.ones(len(angles.time), dtype=np.bool_)
    return np.asarray(poses.observed[:, [skeleton.chain.parents[joint], joint + 1]].all(axis=1))


def draw(data: ReportData) -> Figure | str:
    """Return a panel with the angles of each joint."""
    return _draw_panels(data, "angles", (0,), 1.9)


def draw_rates(data: ReportData) -> Figure | str:
    """Return velocities and accelerations side by side, one line of panels for each joint."""
    return _draw_panels(data, "velocities and accelerations", (1, 2), 1.7)


def _draw_panels(data: ReportData, what: str, derivatives: tuple[int, ...], height: float) -> Figure | str:
    found = collect_joint_motions(data)
    if not found:
        return f"No {what}: {data.why_missing('angles.parquet')}."
    below = ["" for _ in found[1:]] + ["time (s)"]
    rows = zip(found, below, strict=True)
    return Figure(tuple(tuple(one.draw_panel(order, height, below=x) for order in derivatives) for one, x in rows))


_PORTRAITS = ("elbow_flexion", "shoulder_elevation", "shoulder_plane", "shoulder_axial")
_COLOURS = (style.BLUE, style.GREEN, style.VERMILLION)  # first, middle and last third of the curls
_HEIGHT = 2.4


def draw_phase_portraits(data: ReportData) -> Figure | str:
    """Return phase portraits of all complete curls, with a 95 % band of the acceleration for the first and the last."""
    angles, table = data.angles, data.table("events.parquet")
    if angles is None or table is None or "amplitude" not in table.names:
        return "No phase portraits: only `protocol: curl` has them."
    turns = table.stack(["start", "top", "end"])[table["complete"].astype(bool)]
    names = [name for name in _PORTRAITS if name in angles.names]
    if not len(turns) or not names:
        return "No phase portraits: no complete curl was found."
    panels = []
    for name in names:
        items: list[Item] = []
        for k, (start, top, end) in enumerate(turns):
            colour = _COLOURS[len(_COLOURS) * k // len(turns)]
            halves = [(angles.time >= a) & (angles.time <= b) for a, b in ((start, top), (top, end))]
            if k in {0, len(turns) - 1}:
                items += [_draw_band(angles, name, half, colour) for half in halves]
            items.append(_draw_curve(angles, name, halves[0] | halves[1], colour))
        title = style.clean(name.replace("_", " "), 24)
        panels.append(Panel(tuple(items), title, "angle (deg)", "acceleration (rad/s²)", height=_HEIGHT))
    return Figure(arrange_in_lines(tuple(panels), 2))


def _draw_curve(angles: SpatialAngles, name: str, within: BoolArray, colour: str) -> Line:
    mean = angles.mean[within, angles.names.index(name)]
    return Line(np.degrees(mean[:, 0]), mean[:, 2], colour, width=0.8, opacity=0.7)


def _draw_band(angles: SpatialAngles, name: str, within: BoolArray, colour: str) -> Band:
    j = angles.names.index(name)
    mean, half = angles.mean[within, j], NORMAL_95 * angles.sd[within, j, 2]
    order = np.argsort(mean[:, 0], kind="stable")
    return Band(np.degrees(mean[order, 0]), (mean[:, 2] - half)[order], (mean[:, 2] + half)[order], colour, 0.15)
