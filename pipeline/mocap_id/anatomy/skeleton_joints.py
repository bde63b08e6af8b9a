"""Recognition of skeleton joints by name: Kinect v2, Azure Kinect, MediaPipe, Pose2Sim, OpenCap and similar."""

from __future__ import annotations

import re
from collections.abc import Sequence

from mocap_id.anatomy.landmark_names import Side

_MIDDLE = {
    "pelvis": "spinebase pelvis hip hips midhip cmidhip hipcenter hipcentre",
    "spine": "spinemid spinechest chest spinenaval spinenavel torso",
    "spine_top": "spineshoulder shouldercenter shouldercentre",
    "neck": "neck cneck",
    "head": "head",
}
_SIDED = {
    "shoulder": "shoulder sho shoulderjointcenter shoulderjointcentre",
    "elbow": "elbow elb elbowjointcenter elbowjointcentre",
    "wrist": "wrist wri wristjointcenter wristjointcentre",
    "hand": "hand index middle palm",
    "hip": "hip hipjointcenter hipjointcentre hjc",
    "ankle": "ankle ankleankle",
    "foot": "foot footindex bigtoe toe",
}
_MIDDLE_ROLES = {name: role for role, names in _MIDDLE.items() for name in names.split()}
_SIDED_ROLES = {name: role for role, names in _SIDED.items() for name in names.split()}

TRUNK = ("near_shoulder", "far_shoulder", "near_hip", "far_hip", "pelvis", "spine", "spine_top", "neck")
"""Roles of the joints that determine the pose of the trunk."""
ARM = ("elbow", "wrist", "hand")
"""Roles of the joints of the arm, from the shoulder outwards."""


def find_roles(labels: Sequence[str], side: Side) -> dict[str, int]:
    """Return the number of the joint in each role; roles are relative to the arm ``side``.

    Roles are the names in :data:`TRUNK` and :data:`ARM`, and ``far_ankle``, ``near_foot`` and so on. The prefix
    ``near_`` means the side of the chosen arm, ``far_`` the other side. ``labels`` are the names of the joints in the
    file.

    Examples
    --------
    >>> find_roles(["Neck", "ShoulderLeft", "RElbow", "right_wrist", "LElbow"], "right")
    {'neck': 0, 'far_shoulder': 1, 'elbow': 2, 'wrist': 3, 'far_elbow': 4}
    """
    roles: dict[str, int] = {}
    for number, label in enumerate(labels):
        role = _find_role(label, side)
        if role and role not in roles:
            roles[role] = number
    return roles


def _find_role(label: str, side: Side) -> str | None:
    """Return the role of a joint's name; None if the name is not recognised."""
    name = re.sub(r"[^a-z]", "", label.rsplit(":", 1)[-1].lower().replace("_study", ""))
    if name in _MIDDLE_ROLES:
        return _MIDDLE_ROLES[name]
    for own, rest in _split_side(name):
        if rest in _SIDED_ROLES:
            role = _SIDED_ROLES[rest]
            near = own[0] == side[0]
            return role if near and role in ARM else f"{'near' if near else 'far'}_{role}"
    return None


def _split_side(name: str) -> list[tuple[str, str]]:
    """Return possible splits of a name into a side and the rest."""
    splits = []
    for word in ("right", "left", "r", "l"):
        if name.startswith(word):
            splits.append((word, name[len(word) :]))
        if name.endswith(word):
            splits.append((word, name[: -len(word)]))
    return splits
