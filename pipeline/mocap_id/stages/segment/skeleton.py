"""Segments of an arm whose joints a skeleton names."""

from __future__ import annotations

import numpy as np

from mocap_id.anatomy.skeleton_joints import ARM, TRUNK, find_roles
from mocap_id.stages.segment.known_segments import facts_without_search
from mocap_id.store import Table
from mocap_id.store.schemas import SEGMENTS
from mocap_id.store.views import Trajectories

_NAMES = ("thorax", "upper_arm", "forearm", "hand")
_JOINTS = ("shoulder", "elbow", "wrist")


def skeleton_segments(view: Trajectories) -> Table:
    """Return segments.parquet: joints of the trunk show the thorax, each joint of the arm the end of a segment."""
    roles = find_roles(view.labels, view.planar.facts["side"])
    segment = np.full(len(view.labels), -1, dtype=np.int64)
    for role in TRUNK:
        if role in roles:
            segment[roles[role]] = 0
    limbs = [role for role in ARM if role in roles]
    for k, role in enumerate(limbs, start=1):
        segment[roles[role]] = k
    columns = {
        "marker": np.array(view.labels, dtype=object),
        "segment": segment,
        "residual": np.where(segment >= 0, 0.0, np.nan),
        "reason": np.array(
            ["" if k >= 0 else "not a joint of the trunk or of this arm" for k in segment], dtype=object
        ),
    }
    return Table(
        SEGMENTS, columns, facts_without_search(_NAMES[: len(limbs) + 1], _JOINTS[: len(limbs)], range(len(limbs)))
    )
