"""Names of segments and joints by protocol, and the reference body of a person by height, mass and sex."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.priors import Sex, TableName, estimate_height, look_up_table, scale_reference
from mocap_id.verdict import Reason

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


@dataclass(frozen=True)
class ReferenceBody:
    """Inertial parameters of a reference body with the chain of the trial."""

    table: TableName | None  # allometric table, ``winter`` or ``de-leva``; None if there is no reference body
    parameters: FloatArray  # m, mx, my, Izz of every segment, base first; NaN if there is no reference body
    # height, mass: height, m, and mass, kg, of the body; None if there is no reference body
    height: float | None
    mass: float | None
    assumed: tuple[str, ...]  # assumptions about values that the user did not give
    why: str | None  # reason why there is no reference body; None if there is one
    reasons: tuple[Reason, ...]  # notes for the verdict about the assumptions or about ``why``


def build_reference_body(
    name: TableName,
    centres: FloatArray,
    facing: int,
    *,
    height: float | None,
    mass: float | None,
    sex: Sex | None,
    plate_mass: float | None,
    standing: FloatArray | None = None,
) -> ReferenceBody:
    """Build the reference body for a chain of foot, shank, thigh and torso, or with pelvis and trunk instead of torso.

    ``centres`` (n, 2) are the joint centres in the axes of the previous segment, m. ``facing`` is 1 if the person faces
    x in the plane's axes, -1 for -x. ``height``, m, ``mass``, kg, and ``sex`` are given by the user. Without them, the
    height is estimated from shank and thigh, the mass is ``plate_mass``, measured by the plates, kg, and the mean of de
    Leva's two tables is used. ``standing`` (n,) are the angles of the segments in the plane while the person stands,
    rad; None if unknown.
    """
    if len(centres) not in (3, 4):
        why = f"the tables are for chains of 4 or 5 segments, and this one has {len(centres) + 1}"
        return make_empty_reference(len(centres), why)
    reference = look_up_table(name, sex)
    assumed: list[str] = []
    if mass is None:
        if plate_mass is None:
            why = "the mass of the person is unknown, as no plate measures it; give `subject: {mass: …}`"
            return make_empty_reference(len(centres), why)
        mass = plate_mass
        assumed.append(f"a mass of {mass:.1f} kg, from the plates")
    if height is None:
        shank, thigh = (float(np.linalg.norm(end)) for end in centres[1:3])
        height, factor = estimate_height(reference, shank, thigh), reference.shank.length + reference.thigh.length
        legs = f"{shank + thigh:.3f} m / {factor:.3f}"
        assumed.append(f"a height of {height:.2f} m, from the lengths of shank and thigh ({legs})")
    if name == "de-leva" and sex is None:
        assumed.append("the mean of the female and the male table")
    reasons: tuple[Reason, ...] = ()
    if assumed:
        message = f"the reference body ({name}) assumes {'; '.join(assumed)}; give these values under `subject:`"
        reasons = (Reason("reference-assumed", message, level="ok"),)
    parameters = scale_reference(reference, centres, height, mass, facing, standing=standing)
    return ReferenceBody(name, parameters, height, mass, tuple(assumed), None, reasons)


def make_empty_reference(joints: int, why: str | None) -> ReferenceBody:
    """Return a reference body without parameters; if ``why`` is given, it is also a note for the verdict."""
    reasons: tuple[Reason, ...] = ()
    if why is not None:
        reasons = (Reason("no-reference", f"there is no reference body for a comparison: {why}", level="ok"),)
    return ReferenceBody(None, np.full(4 * (joints + 1), np.nan), None, None, (), why, reasons)
