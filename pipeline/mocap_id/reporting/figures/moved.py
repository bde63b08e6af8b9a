"""What a caption says of the motion behind a figure."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.contents import FigureEntry
from mocap_id.reporting.material import Material

_OF_POSES: Mapping[str, str] = {
    "wrench": "The measured wrench is not filtered.",
    "phases": "The measured wrench is not filtered.",
    "parameters": "The parameters are the chain's, computed from the bodies that were fitted with a loose prior.",
    "point_masses": "A panel is a body of the fit. If it is no segment of the chain, its origin is the centroid of its "
    "markers.",
}
_OF_CHAIN: Mapping[str, str] = {
    "parameters": "These numbers hold all that the wrench shows about the body.",
}


def caption(entry: FigureEntry, material: Material) -> str:
    """What stands under a figure; under one of the dynamics, what moves the masses too."""
    if entry.name not in _OF_POSES or material.facts("dynamics.h5").get("motion") is None:
        return entry.caption
    told = [entry.caption, *(_untold(material) if entry.name == "phases" else ())]
    if material.measured_poses:
        cutoffs = ", ".join(f"{axis} {cutoff:g} Hz" for axis, cutoff in (material.bands or {}).items())
        told += [f"The masses move as the measured poses, after low-passes ({cutoffs}).", _OF_POSES[entry.name]]
    else:
        told += ["The masses move as the pinned chain.", _OF_CHAIN.get(entry.name, "")]
    return " ".join(told).rstrip()


def _untold(material: Material) -> list[str]:
    """A sentence on the joints without a torque."""
    names = material.skeleton.joints if material.skeleton is not None else ()
    untold = material.facts("dynamics.h5").get("untold") or ()
    joints = [name for j, name in enumerate(names, start=1) if f"tau_{j}" in untold]
    return [f"The fit does not give the torque of: {', '.join(joints)}."] if joints else []
