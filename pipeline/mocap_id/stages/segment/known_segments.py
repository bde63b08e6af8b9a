"""Segments from a skeleton or a calibration, without a search; columns and facts of segments.parquet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_id.anatomy.skeleton_joints import ARM, TRUNK, find_roles
from mocap_id.arrays import FloatArray, IntArray
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.calibration_trial import get_calibration, read_chain
from mocap_id.store import Table
from mocap_id.store.schemas import SEGMENTS
from mocap_id.store.views import Trajectories

_NAMES = ("thorax", "upper_arm", "forearm", "hand")
_JOINTS = ("shoulder", "elbow", "wrist")


def assign_skeleton(view: Trajectories) -> Table:
    """Return segments.parquet for a skeleton: the trunk is the base, and each joint of the arm ends a segment."""
    roles = find_roles(view.labels, view.planar.facts["side"])
    segment = np.full(len(view.labels), -1, dtype=np.int64)
    limbs = [role for role in ARM if role in roles]
    for role in roles.keys() & {*TRUNK, *limbs}:
        segment[roles[role]] = limbs.index(role) + 1 if role in limbs else 0
    why = ["" if k >= 0 else "not a joint of the trunk or of this arm" for k in segment]
    columns = make_columns(view.labels, segment, np.where(segment >= 0, 0.0, np.nan), why)
    return Table(SEGMENTS, columns, make_facts(_NAMES[: len(limbs) + 1], _JOINTS[: len(limbs)], range(len(limbs))))


def assign_by_calibration(context: Context) -> Outputs:
    """Return segments.parquet for a trial without markers, with the markers and segments of the calibration."""
    tree = read_chain(get_calibration(context.trial))
    names = tree.texts("segments/name")
    segment = tree.integers("markers/segment")
    why = [f"as in the calibration: {names[k]}" for k in segment]
    columns = make_columns(tree.texts("markers/name"), segment, np.full(len(segment), np.nan), why)
    facts = make_facts(names, tree.texts("joints/name"), tree.integers("joints/parent").tolist())
    return (Table(SEGMENTS, columns, facts),)


def make_columns(
    labels: Sequence[str], segment: IntArray, residual: FloatArray, why: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Return the columns of segments.parquet; ``residual``, m, and ``why`` belong to each marker on its segment."""
    return {
        "marker": np.array(labels, dtype=object),
        "segment": segment,
        "residual": residual,
        "reason": np.array(why, dtype=object),
    }


def make_facts(names: Sequence[str], joint_names: Sequence[str], parents: Sequence[int]) -> dict[str, Any]:
    """Return the facts of segments.parquet; the facts about evidence from a search are empty or None.

    ``parents`` are the numbers of the segments before the joints.
    """
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
