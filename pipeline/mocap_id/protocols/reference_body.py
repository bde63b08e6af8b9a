"""The allometric body that a trial's subject is compared with, and what had to be assumed for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.allometry import Sex, Table, TableName, full_parameters, height_from_legs, table
from mocap_id.verdict import Reason


@dataclass(frozen=True)
class ReferenceBody:
    """Full parameters of a reference body on the trial's chain.

    Parameters
    ----------
    table : str or None
        ``winter``, ``de-leva``; None where no reference applies.
    parameters : (4(n + 1),) array
        m, mx, my, Izz of every segment, base first; NaN where no reference applies.
    height, mass : float or None
        Of the body, m and kg.
    assumed : tuple of str
        What was not given, and what stands in for it.
    why : str or None
        Why no reference applies.
    reasons : tuple of Reason
        The same for the verdict.
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
    """A person of this height, mass and sex on a foot-shank-thigh-torso chain (or with the torso in two).

    Parameters
    ----------
    name : {"winter", "de-leva"}
    centres : (n, 2) array
        Joint centres in the segment before, m.
    facing : {-1, 1}
        Sign of x in front of the subject.
    height, mass, sex : optional
        As the user gave them. A missing height is estimated from shank and thigh, a missing mass taken from the
        plates; without the sex de Leva's table is the mean of both.
    plate_mass : float or None
        What the plates show, kg.
    standing : (n,) array or None
        Angle of each segment's frame while the person stands, rad.
    """
    if len(centres) not in (3, 4):
        return no_reference(len(centres), f"the tables describe people of 4 or 5 segments, not of {len(centres) + 1}")
    if mass is None and plate_mass is None:
        return no_reference(
            len(centres), "neither the subject's mass nor a plate's is known: give `subject: {mass: …}`"
        )
    reference = table(name, sex)
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
        reasons=_told(name, assumed),
    )


def _height(reference: Table, centres: FloatArray) -> tuple[float, str]:
    """Stature, m, by the lengths of shank and thigh, and how it came about."""
    shank, thigh = (float(np.linalg.norm(end)) for end in centres[1:3])
    height, factor = height_from_legs(reference, shank, thigh), reference.shank.length + reference.thigh.length
    legs = f"{shank + thigh:.3f} m / {factor:.3f}"
    return height, f"a height of {height:.2f} m, from the lengths of shank and thigh ({legs})"


def _told(name: TableName, assumed: list[str]) -> tuple[Reason, ...]:
    if not assumed:
        return ()
    message = f"the reference body ({name}) assumes {'; '.join(assumed)}; give `subject:` to be exact"
    return (Reason("reference-assumed", message, level="ok"),)


def no_reference(joints: int, why: str | None) -> ReferenceBody:
    """No reference body for a chain of so many joints; without a ``why`` none is to be expected."""
    reasons: tuple[Reason, ...] = ()
    if why is not None:
        reasons = (Reason("no-reference", f"there is no reference body to compare with: {why}", level="ok"),)
    return ReferenceBody(None, np.full(4 * (joints + 1), np.nan), None, None, (), why, reasons)
