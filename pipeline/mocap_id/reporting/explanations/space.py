"""Explanations of reasons that only trials in space have: joints, calibrations and moving bases."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

SPACE: Mapping[str, Explanation] = {
    "planar-motion": Explanation(
        ("ok",),
        "The motion is planar",
        "All markers move in one vertical plane. The results in space are right, but a trial with `space: plane` has "
        "fewer unknowns, and in the plane the dynamics of a person on a force plate can be identified.",
        "Try `space: plane`, unless the trial belongs to a set of trials in space.",
        "planarise",
        "Share of the horizontal motion out of the best vertical plane; limit 0.01.",
    ),
    "branches-left-out": Explanation(
        ("ok",),
        "Some bodies are not part of the chain",
        "A chain has no branches. The markers of these bodies move, but they are on another limb or on something that "
        "is not connected to the chain. They are not used.",
        "Nothing, if they are on another limb. Otherwise put their markers `together` with the segment that they "
        "belong to, or record this limb as a trial of its own.",
        "segment",
        "Number of rigid bodies of moving markers that are on no segment of the chain.",
    ),
    "axes-parallel": Explanation(
        ("ok",),
        "A joint of two axes is fitted as a ball",
        "The two axes that fit the motion best are nearly parallel, so two angles about them cannot be told apart. "
        "This happens when one of the rotations is small against soft tissue. A ball leaves the rotation free; angles "
        "between anatomical frames do not depend on the axes.",
        "Nothing, or record a motion with larger rotations about both axes.",
        "fit-joints",
        "Cosine of the angle between the axes; limit 0.75.",
    ),
    "centre-unknown": Explanation(
        ("caution",),
        "The motion does not show a joint's centre",
        "A centre is found by rotations about it. Here they are too small against soft tissue and noise: every method "
        "would give a number, and each a different one, often centimetres apart. The result therefore has no number "
        "for this centre and for what depends on it: lengths, origins and anatomical frames of the segments.",
        "Record the same person with the same markers in a larger motion of this joint, and name that trial as "
        "`calibration:`.",
        "fit-joints",
        "Whether the standard deviation of the centre, with soft tissue, is small enough to mean a place.",
    ),
    "calibrated": Explanation(
        ("ok",),
        "The chain comes from another trial",
        "Centres, axes and landmark frames are those of the trial named as `calibration:`. They are right only if the "
        "markers were not moved between the trials.",
        "Nothing, if both trials are of the same person and the same marker placement.",
        "fit-joints",
        "Whether the trial has a `calibration:`.",
    ),
    "calibration-differs": Explanation(
        ("caution",),
        "The calibration does not fit the markers",
        "Markers are not where the calibration has them on their segments, or are missing. They were moved, exchanged "
        "or named differently, or the calibration is of another person. Centres and angles are then wrong.",
        "Use a calibration of the same session with the same labels. If single markers were replaced, leave them out "
        "with `segment: {ignore}` in both trials.",
        "segment",
        "Distance of a marker from its place in the rigid segment of the calibration, rms, m; limit 0.02. Or fewer "
        "than three of a segment's markers are in this trial.",
    ),
    "base-not-carried": Explanation(
        ("caution",),
        "The plate carries more than the chain",
        "Inertial parameters in space need the whole force under the base, as under a robot that stands on a plate. "
        "Under a person the plate also measures legs and trunk, which carry no markers here, so no parameters are "
        "given. Kinematics are not affected.",
        "Nothing for an arm. For a device, put markers on its base and the base on the plate.",
        "identify-dim",
        "Whether the base is a person's thorax, or a joint on the way to the base has an unknown centre.",
    ),
    "base-unseen": Explanation(
        ("caution",),
        "The base is not seen",
        "The wrench on the base can only be used if its pose is known. No frame shows it, so no parameters are given.",
        "Put at least three markers on the base.",
        "identify-dim",
        "Whether any frame has a pose of the base.",
    ),
    "base-moves": Explanation(
        ("caution",),
        "The base moves on the plate",
        "The identification in space assumes a base at rest. This one moves, so the plate also measures its own "
        "inertia or that of what carries it, and no parameters are given. Kinematics are not affected.",
        "Fix the base to the plate, or leave out the time in which it moves with `window:`.",
        "identify-dim",
        "95 % quantile of the base's shift and rotation; limits 5 mm and 1°.",
    ),
    "wrench-unexplained": Explanation(
        ("caution",),
        "The motion does not explain the force",
        "The horizontal force on the plate hardly follows the motion of the chain. The plate does not carry this base, "
        "its clock is wrong, or something else on it moves. The parameters are fitted to something else: do not use "
        "them.",
        "Check which plate carries the base (`plates:`), and that nothing else touches it.",
        "identify-dim",
        "Share of the variance of the horizontal force that the model explains; limit 0.5.",
    ),
}
"""Explanations by reason code."""
