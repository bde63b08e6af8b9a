"""Allometric reference body of the subject, and the assumptions behind it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.allometry import (
    ReferenceTable,
    Sex,
    TableName,
    full_parameters,
    height_from_legs,
    reference_table,
)
from mocap_id.verdict import Reason


@dataclass(frozen=True)
class ReferenceBody:
    """Full parameters of a reference body on the chain of the trial.

    Parameters
    ----------
    table : str or None
        ``winter`` or ``de-leva``; None if no reference applies.
    parameters : (4(n + 1),) array
        m, mx, my, Izz of every segment, base first; NaN if no reference applies.
    height, mass : float or None
        Height and mass of the body, m and kg.
    assumed : tuple of str
        Assumptions made for values that were not given.
    why : str or None
        Why no reference applies.
    reasons : tuple of Reason
        Assumptions, or ``why``, as reasons for the verdict.
    """

    table: TableName | None
    parameters: FloatArray
    height: float | None
    mass: float | None
    assumed: tuple[str, ...]
    why: str | None
    reasons: tuple[Reason, ...]


def reference_body(
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
    """Build the reference body for a foot-shank-thigh-torso chain, or one with pelvis and trunk.

    Parameters
    ----------
    name : {"winter", "de-leva"}
    centres : (n, 2) array
        Joint centres in the frame of the previous segment, m.
    facing : {-1, 1}
        Sign of the x axis in front of the subject.
    height, mass, sex : optional
        Values given by the user. A missing height is estimated from shank and thigh, a missing mass is taken from
        the plates, and without the sex the mean of de Leva's two tables is used.
    plate_mass : float or None
        Mass measured by the plates, kg.
    standing : (n,) array or None
        Angle of each segment frame while the person stands, rad.
    """
    if len(centres) not in (3, 4):
        return no_reference(len(centres), f"the tables describe people of 4 or 5 segments, not of {len(centres) + 1}")
    if mass is None and plate_mass is None:
        return no_reference(
            len(centres), "neither the mass of the subject nor that on a plate is known; give `subject: {mass: …}`"
        )
    reference = reference_table(name, sex)
    assumed: list[str] = []
    if mass is None:
        assert plate_mass is not None
        mass = plate_mass
        assumed.append(f"a mass of {mass:.1f} kg, from the plates")
    if height is None:
        height, how = _height(reference, centres)
        assumed.append(how)
    if name == "de-leva" and sex is None:
        assumed.append("the mean of the female and the male table")
    return ReferenceBody(
        table=name,
        parameters=full_parameters(reference, centres, height, mass, facing, standing=standing),
        height=height,
        mass=mass,
        assumed=tuple(assumed),
        why=None,
        reasons=_assumption_reasons(name, assumed),
    )


def _height(reference: ReferenceTable, centres: FloatArray) -> tuple[float, str]:
    """Estimate the stature, m, from the lengths of shank and thigh; also return the assumption in words."""
    shank, thigh = (float(np.linalg.norm(end)) for end in centres[1:3])
    height, factor = height_from_legs(reference, shank, thigh), reference.shank.length + reference.thigh.length
    legs = f"{shank + thigh:.3f} m / {factor:.3f}"
    return height, f"a height of {height:.2f} m, from the lengths of shank and thigh ({legs})"


def _assumption_reasons(name: TableName, assumed: list[str]) -> tuple[Reason, ...]:
    if not assumed:
        return ()
    message = f"the reference body ({name}) assumes {'; '.join(assumed)}; give these values under `subject:`"
    return (Reason("reference-assumed", message, level="ok"),)


def no_reference(joints: int, why: str | None) -> ReferenceBody:
    """Return an empty reference body for a chain with this many joints; without ``why`` it has no reason."""
    reasons: tuple[Reason, ...] = ()
    if why is not None:
        reasons = (Reason("no-reference", f"there is no reference body to compare with: {why}", level="ok"),)
    return ReferenceBody(None, np.full(4 * (joints + 1), np.nan), None, None, (), why, reasons)
