"""The stage fit-joints for a trial of inertial sensors alone: the chain is that of the calibration."""

from __future__ import annotations

from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.calibration import get_calibration, read_chain
from mocap_id.store import Tree
from mocap_id.store.schemas import CHAIN
from mocap_id.verdict import Reason


def calibrated_chain(context: Context) -> Outputs:
    """Return chain.h5 of a trial without markers."""
    calibration = get_calibration(context.trial)
    tree = read_chain(calibration)
    name = calibration.trial.name
    note = Reason("calibrated", f"the joint centres and the segments' axes are those of {name}.", level="ok")
    kept = tuple(reason for reason in tree.reasons if reason.level != "ok")
    return (Tree(CHAIN, tree.data, {**tree.facts, "calibration": name}, (note, *kept)),)
