"""Names of segments and joints, by protocol."""

from __future__ import annotations

from collections.abc import Sequence

_SIT_TO_STAND = {
    2: (("foot", "body"), ("ankle",)),
    3: (("foot", "shank", "thigh"), ("ankle", "knee")),
    4: (("foot", "shank", "thigh", "torso"), ("ankle", "knee", "hip")),
    5: (("foot", "shank", "thigh", "pelvis", "trunk"), ("ankle", "knee", "hip", "lumbar")),
}

GROUND = "ground"
"""Name of the base if the foot rotates on the ground and is a segment itself."""

LONGEST = {"sit-to-stand": 5, "robot-joint": 4, "free": 8}
"""Largest number of segments of a chain, including the base, by protocol; arms do not belong to the chain."""


_DIRECTIONS = {  # of a positive and of a negative torque or angle, if the person faces -x
    "ankle": ("dorsiflexion", "plantarflexion"),
    "knee": ("extension", "flexion"),
    "hip": ("flexion", "extension"),
    "lumbar": ("flexion", "extension"),
}


def name_directions(joints: Sequence[str], facing: int) -> dict[str, list[str]]:
    """Return the movements towards which a positive and a negative torque act, by joint; only for joints of the body.

    ``facing`` is 1 if the person faces x in the plane's axes, else -1.

    Examples
    --------
    >>> name_directions(["knee", "joint 2"], -1)
    {'knee': ['extension', 'flexion']}
    """
    return {name: list(_DIRECTIONS[name][::-facing]) for name in joints if name in _DIRECTIONS}


def name_chain(protocol: str, count: int, *, foot_turns: bool = False) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names for ``count`` segments, base first, and for the ``count - 1`` joints between them.

    If the foot rotates on the ground (``foot_turns``), it is the first moving segment.

    Examples
    --------
    >>> name_chain("sit-to-stand", 4)[1]
    ('ankle', 'knee', 'hip')
    >>> name_chain("free", 3)
    (('base', 'segment 1', 'segment 2'), ('joint 1', 'joint 2'))
    >>> name_chain("sit-to-stand", 4, foot_turns=True)
    (('ground', 'foot', 'shank', 'thigh'), ('toes', 'ankle', 'knee'))
    """
    if foot_turns and protocol == "sit-to-stand" and count - 1 in _SIT_TO_STAND:
        segments, joints = _SIT_TO_STAND[count - 1]
        return (GROUND, *segments), ("toes", *joints)
    if protocol == "sit-to-stand" and count in _SIT_TO_STAND:
        return _SIT_TO_STAND[count]
    if protocol == "robot-joint" and count == 2:
        return ("base", "link"), ("joint",)
    return (
        ("base", *(f"segment {k}" for k in range(1, count))),
        tuple(f"joint {k}" for k in range(1, count)),
    )
