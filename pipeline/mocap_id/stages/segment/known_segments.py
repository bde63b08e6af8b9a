"""Segments that are known without a search: those of a skeleton, or of a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_id.anatomy.skeleton_joints import ARM, TRUNK, find_roles
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.calibration import get_calibration, read_chain
from mocap_id.store import Table
from mocap_id.store.schemas import SEGMENTS
from mocap_id.store.views import Trajectories

_NAMES = ("thorax", "upper_arm", "forearm", "hand")
_JOINTS = ("shoulder", "elbow", "wrist")


def skeleton_segments(view: Trajectories) -> Table:
    """Return segments.parquet of a skeleton: the trunk is the thorax, each joint of the arm the end of a segment."""
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


def calibrated_segments(context: Context) -> Outputs:
    """Return segments.parquet of a trial of inertial sensors alone: the segments are those of the calibration."""
    tree = read_chain(get_calibration(context.trial))
    names = tree.texts("segments/name")
    segment = tree.integers("markers/segment")
    columns = {
        "marker": np.array(tree.texts("markers/name"), dtype=object),
        "segment": segment,
        "residual": np.full(len(segment), np.nan),
        "reason": np.array([f"as in the calibration: {names[k]}" for k in segment], dtype=object),
    }
    facts = facts_without_search(names, tree.texts("joints/name"), tree.integers("joints/parent").tolist())
    return (Table(SEGMENTS, columns, facts),)


def facts_without_search(names: Sequence[str], joint_names: Sequence[str], parents: Sequence[int]) -> dict[str, Any]:
    """Return the facts of segments.parquet where the segments are known and no evidence is weighed."""
    return {
        "count": len(names),
        "names": list(names),
        "joint_names": list(joint_names),
        "parents": list(parents),
        "joint_markers": {},
        "links": None,
        "bad_stretches": [],
        "confidence": None,
        "against": {},
        "planarity": None,
        "joint_confidences": [],
        "joint_ratios": [],
        "asymmetry_deg": [],
        "noise_floor_m": None,
        "static_gap": None,
        "hypotheses": [],
        "divisions": [],
    }
