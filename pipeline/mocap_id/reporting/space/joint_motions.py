"""Angles of each joint in space as joint states, for the figures that also draw the states of a chain in the plane."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray
from mocap_id.geometry.circle import shift_to_shortest_arc
from mocap_id.reporting import style
from mocap_id.reporting.downsampling import spans
from mocap_id.reporting.figure import Panel, Spans
from mocap_id.reporting.figures.states import panel
from mocap_id.reporting.report_data import ReportData
from mocap_id.store.spatial_views import MEANINGLESS_AT_POLE, SpatialAngles
from mocap_id.store.views import JointStates

_ANATOMICAL = {"upper_arm": "shoulder", "forearm": "elbow", "hand": "wrist"}
"""Names of the angles of the joints that move these segments."""


@dataclass(frozen=True)
class JointMotion:
    """The angles of one joint.

    Parameters
    ----------
    title : str
    names : tuple of str
        Names of its angles.
    states : JointStates
        NaN where an angle has no meaning.
    near_gimbal : (T,) array
        Samples in which some of these angles have no meaning.
    """

    title: str
    names: tuple[str, ...]
    states: JointStates
    near_gimbal: BoolArray

    def panel(self, order: int, height: float, *, below: str = "") -> Panel:
        """Return the angles (order 0), velocities or accelerations over time, with 95 % bands and shades."""
        drawn = panel(self.states, order, self.names, height)
        found = np.array(spans(self.states.time, self.near_gimbal)).reshape(-1, 2)
        shade = (Spans(found[:, 0], found.sum(axis=1), style.SKY, 0.25),) if len(found) else ()
        return replace(drawn, items=(*shade, *drawn.items), title=self.title, x=below)


def joint_motions(data: ReportData) -> list[JointMotion]:
    """Return the angles joint by joint; empty if nothing was estimated."""
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
            found.append(_motion(joint, own, angles, _observed(data, j)))
    return [*found, _motion("other angles", left, angles, _observed(data, None))] if left else found


def _motion(joint: str, own: list[str], angles: SpatialAngles, observed: BoolArray) -> JointMotion:
    columns = [angles.names.index(name) for name in own]
    mean = angles.mean[:, columns].copy()
    for k, name in enumerate(own):
        usable = angles.find_usable(name)
        if name in MEANINGLESS_AT_POLE and usable.any():
            mean[usable, k, 0] = shift_to_shortest_arc(mean[usable, k, 0])
        mean[~usable, k] = np.nan
    states = JointStates(angles.time, mean, angles.sd[:, columns], np.tile(observed[:, None], (1, len(own))))
    near = angles.near_gimbal & any(name in MEANINGLESS_AT_POLE for name in own)
    names = tuple(style.printable(name.replace("_", " "), 24) for name in own)
    return JointMotion(style.printable(joint.replace("_", " "), 24), names, states, near)


def _observed(data: ReportData, joint: int | None) -> BoolArray:
    """Return the samples (T,) in which both segments of a joint are observed."""
    angles, poses, skeleton = data.angles, data.segment_poses, data.spatial_skeleton
    assert angles is not None
    if joint is None or poses is None or skeleton is None or len(poses.time) != len(angles.time):
        return np.ones(len(angles.time), dtype=np.bool_)
    return np.asarray(poses.observed[:, [skeleton.chain.parents[joint], joint + 1]].all(axis=1))
