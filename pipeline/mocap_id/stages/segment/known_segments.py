"""Facts of segments.parquet for segments that are known without a search: of a skeleton or a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


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
