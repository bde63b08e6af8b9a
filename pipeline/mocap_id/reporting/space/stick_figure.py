"""Stick figure of a chain in space: points of joints and ends of sticks in the frame of the trial."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.reporting.report_data import ReportData


@dataclass(frozen=True)
class StickFigure:
    """Sticks and joints in K samples.

    Parameters
    ----------
    segments : tuple of int
        Segment of each stick.
    sticks : tuple of (K, 2, 3) arrays
        Start and end of each stick, m.
    joints : (K, J, 3) array
        Centres of the joints that the motion shows, m.
    names : tuple of str
        Names of these joints.
    """

    segments: tuple[int, ...]
    sticks: tuple[FloatArray, ...]
    joints: FloatArray
    names: tuple[str, ...]


def stick_figure(data: ReportData, samples: IntArray) -> StickFigure | None:
    """Return the stick figure at some samples of the poses; None without chain or poses.

    A stick leads from the joint of a segment to the next joint, or to the centroid of its markers if there is none. It
    begins at this centroid if the segment has no joint, or if the motion does not show it.
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
