"""Names of the segments and joints of a movement."""

from __future__ import annotations

_SIT_TO_STAND = {
    2: (("foot", "body"), ("ankle",)),
    3: (("foot", "shank", "thigh"), ("ankle", "knee")),
    4: (("foot", "shank", "thigh", "torso"), ("ankle", "knee", "hip")),
    5: (("foot", "shank", "thigh", "pelvis", "trunk"), ("ankle", "knee", "hip", "lumbar")),
}

GROUND = "ground"
"""Name of the base under a foot that turns."""

LONGEST = {"sit-to-stand": 5, "robot-joint": 4, "free": 8}
"""Maximum number of segments for each protocol, including the base; arms are branches, not links of the chain."""


def body_names(protocol: str, count: int, *, foot_turns: bool = False) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names for ``count`` segments, base first, and for the ``count - 1`` joints between them.

    If the ``foot_turns`` on the ground, it is the first moving segment.

    Examples
    --------
    >>> body_names("sit-to-stand", 4)[1]
    ('ankle', 'knee', 'hip')
    >>> body_names("free", 3)
    (('base', 'segment 1', 'segment 2'), ('joint 1', 'joint 2'))
    >>> body_names("sit-to-stand", 4, foot_turns=True)
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
