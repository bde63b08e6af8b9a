"""Reference body of a person: inertial parameters from allometric tables, by height, mass and sex."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.priors import Sex, TableName, estimate_height, look_up_table, scale_reference
from mocap_id.verdict import Reason


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
