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
    "skeleton-biases": Explanation(
        ("caution",),
        "The angles come from a skeleton",
        "A depth camera or markerless software places every joint centimetres from the anatomical one, with an error "
        "that lasts for the whole trial and changes with the posture. The chain has constant lengths and the standard "
        "deviations hold these errors, but values remain biased. The carrying angle of the elbow is assumed, pronation "
        "is not shown, and the axial rotation has no value while the elbow is nearly straight.",
        "Compare changes and ranges rather than values, and trials of the same camera and place. Record with markers "
        "where the axial rotation or absolute angles matter.",
        "fit-joints",
        "Every trial with `recording: {skeleton: …}`. docs/recordings.md has the errors of simulated depth cameras.",
    ),
    "skeleton-mirrored": Explanation(
        ("caution",),
        "The skeleton is a mirror image",
        "Hands or feet lie behind the trunk. Some programs mirror the picture or exchange left and right. The file was "
        "mirrored back, but it cannot be known which arm its names mean.",
        "Check which arm moved, and set `side:` to the name that the file gives it.",
        "planarise",
        "Distance of the feet, else of the hand, behind the trunk, median, m; limit 0.05.",
    ),
    "skeleton-incomplete": Explanation(
        ("refused",),
        "The skeleton does not show the arm",
        "The chain needs shoulder, elbow and wrist of one arm, the other shoulder, and a joint of the spine or the "
        "hips. Joints are found by the names of Kinect v2, Azure Kinect, MediaPipe, Pose2Sim and OpenCap.",
        "Export these joints, name them as one of these programs does, or set `side:` to the arm that the file has.",
        "planarise",
        "A joint is missing, or hardly any frame shows it.",
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
        "markers were not moved between the trials. Skin slides with each motion, so the axes of a joint of two axes, "
        "such as the elbow, are corrected where this trial turns it far enough.",
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
        "The wrench on the base can only be used if the pose of the base is known. No frame shows the base, so no "
        "parameters are given.",
        "Put at least three markers on the base.",
        "identify-dim",
        "Whether any frame has a pose of the base.",
    ),
    "base-moves": Explanation(
        ("caution",),
        "The base moves on the plate",
        "The identification in space assumes a base at rest. This one moves, so the plate also measures its own "
        "inertia or that of what carries it, and no parameters are given. Kinematics are not affected.",
        "Fix the base to the plate, or use `window:` to leave out the time in which it moves.",
        "identify-dim",
        "95 % quantile of the base's shift and rotation; limits 5 mm and 1°.",
    ),
    "elbow-backwards": Explanation(
        ("caution",),
        "The elbow bends backwards",
        "In the anatomical frames of the given side, the flexion of the elbow is negative. A left arm that is taken "
        "for a right one shows this, and so do exchanged landmarks. All angles of shoulder and elbow are then wrong.",
        "Set `side: left` or `side: right`. Without it the arm is taken for a right one. Check that EM is the medial "
        "and EL the lateral epicondyle.",
        "ukf-smooth",
        "2 % quantile of the flexion, degrees; limit -20, and more negative than the 98 % quantile is positive.",
    ),
    "no-reach": Explanation(
        ("caution",),
        "The reachable volume is unknown",
        "The volume needs plane, elevation and axial rotation of the shoulder, the flexion of the elbow, the centres "
        "of both joints and the wrist, and a motion that moves all four angles. The message names what is missing. "
        "Ranges of the other angles are given.",
        "Name the landmarks under `landmarks:`, record reaches to hip, shoulders, mouth and head, or use "
        "`calibration:`. If the elbow seems to bend backwards, give the right `side:`.",
        "identify-dim",
        "Range of each of the four angles; limit 2°.",
    ),
    "no-curls": Explanation(
        ("caution",),
        "No curl was counted",
        "Curls are counted from the flexion of the elbow, which needs landmarks on upper arm and forearm: EL, EM, US "
        "and RS. A curl rises by at least `attempt_deg` and by the share `complete` of the trial's large curls, and "
        "returns.",
        "Name the landmarks under `landmarks:`, or use `calibration:`, a trial of the same person and markers in which "
        "every joint moves. If the elbow does curl in the report's angles, change `curl: {attempt_deg: …}`.",
        "identify-dim",
        "Complete curls up to the end of the trial; limit 1.",
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
