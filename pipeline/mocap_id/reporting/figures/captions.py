"""Captions of the figures, with a sentence on the motion of the masses."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.contents import FigureEntry
from mocap_id.reporting.report_data import ReportData

_OF_POSES: Mapping[str, str] = {
    "wrench": "The measured wrench is not filtered.",
    "phases": "The measured wrench is not filtered.",
    "parameters": "The parameters are computed from bodies that were fitted with a loose prior.",
    "point_masses": "Each panel is a body of the fit. If a body is not a segment of the chain, its origin is the "
    "centroid of its markers.",
}
_OF_CHAIN: Mapping[str, str] = {
    "parameters": "The parameters contain all information about the body in the wrench.",
}


def caption(entry: FigureEntry, data: ReportData) -> str:
    """Return the caption of a figure; for figures of the dynamics, including the motion of the masses."""
    if entry.name not in _OF_POSES or data.facts("dynamics.h5").get("motion") is None:
        return entry.caption
    sentences = [entry.caption, *(_missing_torques(data) if entry.name == "phases" else ())]
    if data.measured_poses:
        cutoffs = ", ".join(f"{axis} {cutoff:g} Hz" for axis, cutoff in (data.bands or {}).items())
        sentences += [f"The masses move with the measured poses, low-pass filtered ({cutoffs}).", _OF_POSES[entry.name]]
    else:
        sentences += ["The masses move with the pinned chain.", _OF_CHAIN.get(entry.name, "")]
    return " ".join(sentences).rstrip()


def _missing_torques(data: ReportData) -> list[str]:
    """Return a sentence on the joints without a torque, if there are any."""
    names = data.skeleton.joints if data.skeleton is not None else ()
    missing = data.facts("dynamics.h5").get("untold") or ()
    joints = [name for j, name in enumerate(names, start=1) if f"tau_{j}" in missing]
    return [f"The fit does not determine the torque of: {', '.join(joints)}."] if joints else []
