"""The stage segment for a trial of inertial sensors alone: the segments are those of the calibration."""

from __future__ import annotations

import numpy as np

from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.calibration import read_chain
from mocap_id.stages.segment.known_segments import facts_without_search
from mocap_id.stages.sensors_alone import shown_by
from mocap_id.store import Table
from mocap_id.store.schemas import SEGMENTS


def calibrated_segments(context: Context) -> Outputs:
    """Return segments.parquet of a trial without markers."""
    tree = read_chain(shown_by(context.trial))
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
