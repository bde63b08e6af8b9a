"""Explanations of reasons about the landmarks of an arm, its segment frames and the still pose."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

LANDMARKS: Mapping[str, Explanation] = {
    "two-arms": Explanation(
        ("caution",),
        "Landmarks of both arms",
        "The recording names landmarks of both arms, and one arm is treated at a time. The arm with more landmarks "
        "was used.",
        "Write `side: right` or `side: left`.",
        "fit-joints",
        "Both arms have at least two named landmarks and the trial has no `side:`.",
    ),
    "landmark-ambiguous": Explanation(
        ("caution",),
        "Two markers for one landmark",
        "Two markers have names that mean the same landmark. Neither was used, and frames that need it are missing.",
        "Name the right one under `landmarks:`.",
        "fit-joints",
        "Two names are equally good spellings of one landmark.",
    ),
    "landmark-doubtful": Explanation(
        ("caution",),
        "A landmark with a doubtful name",
        "A name such as Sternum, STRN or T10 is in use for more than one place on the body. It was taken as the "
        "landmark that the message names. At another place, it tilts the frame of the thorax by a few degrees, "
        "constantly.",
        "Compare with the protocol of the recording, and name the landmark under `landmarks:`.",
        "fit-joints",
        "No marker has a better name for this landmark.",
    ),
    "landmark-hidden": Explanation(
        ("caution", "ok"),
        "A landmark that the still pose does not show",
        "A landmark is tied to the markers of its segment in the still pose, where the skin has not moved. This one "
        "was not seen there. Its mean over the whole recording was used, or, if it is never seen, it was left out.",
        "Choose a pose under `static:` in which all landmarks are seen.",
        "fit-joints",
        "No frame of the still pose shows the landmark together with its segment.",
    ),
    "landmark-loose": Explanation(
        ("caution",),
        "A landmark that moves against its segment",
        "In the still pose a landmark moves against the markers of its segment, so it is on another segment, or the "
        "pose is not still. Frames that use it are wrong.",
        "Check the name of the marker, and `static:`.",
        "fit-joints",
        "rms motion of the landmark in the frame of its segment during the still pose, m; limit 10 mm.",
    ),
    "no-still-pose": Explanation(
        ("caution",),
        "No still pose",
        "Landmarks are tied to the segments in a pose in which skin does not slide. No such pose was found, so the "
        "constant errors of the angles are larger than stated.",
        "Record a second of rest, or name a still moment under `static:`.",
        "fit-joints",
        "90th percentile of the markers' speeds in the pose, m/s; limit 20 mm/s for 0.3 s.",
    ),
    "no-isb-frame": Explanation(
        ("caution",),
        "A segment without its ISB frame",
        "Landmarks of a segment are missing, so its frame cannot be built. Angles of its joints that need the frame "
        "are left out; the joint's own coordinates are given instead.",
        "Name the markers under `landmarks:`, or record pointer trials.",
        "fit-joints",
        "A landmark in the definition of the frame is not known.",
    ),
    "wrist-at-rest": Explanation(
        ("ok",),
        "Wrist angles count from the still pose",
        "The hand has no landmarks. Its frame is parallel to that of the forearm in the still pose, so the angles of "
        "the wrist are zero there.",
        "Nothing, if the wrist was straight. Otherwise add MCP2 and MCP5 as landmarks.",
        "fit-joints",
        "MCP2 or MCP5 is not known.",
    ),
    "landmarks-implausible": Explanation(
        ("caution",),
        "The landmarks do not make an arm",
        "The skeleton is not that of an arm: a landmark of the thorax below its lower neighbour, landmarks of the "
        "thorax out of one plane, the shoulder on the wrong side, landmarks of elbow or wrist far from the joint that "
        "the motion determines, an axis of the elbow across its epicondyles, or a segment that is too short or too "
        "long. The usual causes are two exchanged names, a wrong side, a wrong unit and a wrong vertical axis. The "
        "angles are then wrong by up to 180°.",
        "Compare the names of the landmarks in the recording with the body. Give the right ones under `landmarks:`, "
        "and the unit or axis by `planarise: {units: …, vertical: …}`.",
        "fit-joints",
        "The number of contradictions. Limits: 50 mm (height, and middle of two landmarks), 25 mm (plane), 45° "
        "(axis), 0.15 to 0.45 m (upper arm), 0.12 to 0.40 m (forearm).",
    ),
    "motion-implausible": Explanation(
        ("caution",),
        "No arm moves like this",
        "The thorax leans far from the vertical for most of the trial, or the forearm is turned as no forearm is. The "
        "usual causes are a wrong vertical axis of the recording and exchanged landmarks, such as RS and US. The "
        "angles are then wrong by up to 180°, and torques by the direction of gravity.",
        "Give the axis by `planarise: {vertical: …}`, and check the names of the landmarks. If the person lies, the "
        "angles are right.",
        "ukf-smooth",
        "The number of contradictions. Limits: 45° (median of the thorax), mean pronation of -150 to -40°.",
    ),
    "elbow-not-bent": Explanation(
        ("caution",),
        "No pose for the second humerus option",
        "The ISB's second option for the frame of the upper arm takes the axis of flexion from the forearm, in a pose "
        "with the elbow near 90°. There is no such pose, or the landmark US is missing. The first option was used.",
        "Bend the elbow by 90° once in the recording and name the landmark US, or set `fit-joints: {humerus: 1}`.",
        "fit-joints",
        "The angle between upper arm and forearm in the chosen pose; 60 to 120° is needed.",
    ),
    "pointer-bent": Explanation(
        ("caution",),
        "The pointer does not fit its markers",
        "The markers of the pointer are not on a straight line at their stated distances from its tip. Landmarks "
        "that it touched may be off by more than stated.",
        "Check the distances of the pointer, and that they are in the order of its markers.",
        "fit-joints",
        "rms distance of the markers from their places on the pointer, m; limit 5 mm.",
    ),
    "pointer-moves": Explanation(
        ("caution",),
        "The pointer slides",
        "During a pointer trial its tip moves against the segment, so it does not stay on the landmark.",
        "Cut the trial to the touch, or record it again.",
        "fit-joints",
        "rms motion of the tip in the frame of the segment, m; limit 5 mm.",
    ),
}
