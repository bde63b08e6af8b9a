"""Checks before the fit whether parameters can be identified from a trial."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.dynamics.allometry import estimate_height, look_up_table
from mocap_id.dynamics.fit import determines_parameters
from mocap_id.dynamics.preparation import PreparedTrial, TrialData, measure_arcs
from mocap_id.dynamics.sample_choice import LEAST_SECONDS, select_samples
from mocap_id.protocols.movement import Movement
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.trial_data import read_skeleton
from mocap_id.verdict import Reason

MASS_CONTRADICTS = 0.2
"""Relative difference of two masses of one person from which the trial is refused."""

_THIN, _HEAVY = ((1.1, 1.5), (12.0, 14.0)), 42.0
"""Least body mass index for the heights in the first tuple, and largest one, kg/m²."""

_UNUSUAL, _POUND_KG = 36.0, 0.4536
"""Body mass index from which the mass is to be confirmed: a thin person's mass in pounds gives such an index too."""

_BESIDE_M, _BESIDE_SHARE = 0.05, 0.2
"""A foot this far beside all plates, m, is certainly not measured if the force is also this near to the other foot, as
a fraction of the distance of the feet.
"""

_ABSURD = (10.0, 75.0)
"""Range of the body mass index outside which a mass is not used."""


@dataclass(frozen=True)
class NotIdentifiable:
    """Code and text of the reason why nothing can be identified; ``mass`` is the mass, kg, or None if unknown."""

    code: str
    why: str
    mass: float | None = None


def check_wrench(context: Context, recorded: TrialData) -> NotIdentifiable | None:
    """Return the reason why the data do not suffice for an identification; None if they do."""
    facts = context.table("wrench.parquet").facts
    if facts.get("unusable"):
        text = f"the inertial parameters need the moments of the ground's wrench: {facts['unusable']}"
        return NotIdentifiable("no-wrench", text, facts.get("mass_kg"))
    measured = np.isfinite(recorded.surroundings).all(axis=1)
    if not measured.any():
        why = facts.get("why") or "the recording has no usable force plate"
        return NotIdentifiable("no-wrench", f"the inertial parameters need the ground's wrench: {why}")
    standing, given = facts.get("mass_kg"), context.trial.subject.mass
    implausible = judge_mass(context, standing)
    if implausible is not None and implausible.code != "mass-implausible":
        implausible = None
    absurd = implausible is not None and not _ABSURD[0] <= (implausible.value or 0.0) <= _ABSURD[1]
    beside = (facts.get("registration") or {}).get("foot_beside")
    confirmed = standing is not None and given is not None and abs(standing / given - 1.0) <= MASS_CONTRADICTS
    clear = beside is not None and (beside["beside_m"] or 0.0) > _BESIDE_M and abs(beside["share"]) < _BESIDE_SHARE
    if implausible is not None and (absurd or beside is not None):
        text = f"the inertial parameters need the whole wrench of the ground: {implausible.message}"
        return NotIdentifiable("mass-implausible", text)
    if clear and not confirmed:
        text = (
            "the inertial parameters need the whole wrench of the ground, but one foot stands beside the plates "
            "(`foot-off-plate`). If the corners of the plates are wrong instead, give `subject: {mass: …}`"
        )
        return NotIdentifiable("no-wrench", text)
    known = np.isfinite(recorded.ddq).all(axis=1)
    if (measured & known).sum() < LEAST_SECONDS * recorded.rate:
        return NotIdentifiable(
            "no-common-samples",
            f"wrench and joint angles are both known for {(measured & known).sum() / recorded.rate:.2f} s, expected at "
            f"least {LEAST_SECONDS:g} s",
            facts.get("mass_kg"),
        )
    return None


def judge_mass(context: Context, mass: float | None) -> Reason | None:
    """Return a caution if a mass, kg, does not fit the height of the person, or must be confirmed.

    The value of the caution is the body mass index, kg/m².

    The height is that in the configuration, or else follows from shank and thigh. Without one of these, or if the given
    mass of the person confirms the mass, the result is None.
    """
    subject, chain = context.trial.subject, read_skeleton(context)
    if mass is None or context.trial.protocol == "robot-joint":
        return None
    if subject.mass is not None and abs(mass / subject.mass - 1.0) <= MASS_CONTRADICTS:
        return None
    height, source = subject.height, "`subject: {height: …}`"
    if height is None:
        if not {"shank", "thigh"} <= set(chain.segments):
            return None
        ends = [chain.centres[chain.segments.index(name)] for name in ("shank", "thigh")]
        height = estimate_height(look_up_table("winter", None), *(float(np.linalg.norm(end)) for end in ends))
        source = "the lengths of shank and thigh"
    index = mass / height**2
    low = float(np.interp(height, *_THIN))
    if low <= index <= _UNUSUAL:
        return None
    if _UNUSUAL < index <= _HEAVY:
        return Reason(
            "mass-unusual",
            f"the plates measure {mass:.1f} kg, and the height is {height:.2f} m (from {source}): a body mass index of "
            f"{index:.1f} kg/m². This is right for a very heavy person, but loads in pounds give the same for a person "
            f"of {_POUND_KG * mass:.1f} kg, and forces alone cannot tell the two apart. Weigh the person and give "
            "`subject: {mass: …}`",
            value=index,
            limit=_UNUSUAL,
        )
    unit = "the plates measure only a part of the weight, or have a wrong gain or unit"
    if index > _HEAVY:
        unit = "the loads have a wrong gain or unit (such as pounds), or the plates carry something else"
    return Reason(
        "mass-implausible",
        f"the plates measure {mass:.1f} kg, but the height is {height:.2f} m (from {source}): a body mass index of "
        f"{index:.1f} kg/m², expected {low:g} to {_HEAVY:g}. Probably {unit}; then all forces, masses and torques are "
        "wrong. Check that both feet are on plates that are used, and the units. If the mass is right, give `subject: "
        "{mass: …}`",
        value=index,
        limit=_HEAVY if index > _HEAVY else low,
    )


def check_excitation(context: Context, prepared: PreparedTrial, movement: Movement) -> NotIdentifiable | None:
    """Return the reason why the usable samples do not determine the parameters; None if they do."""
    settings, recorded = context.settings, prepared.recorded
    chosen = select_samples(prepared, movement.free)
    mass = context.table("wrench.parquet").facts.get("mass_kg")
    if not movement.free.any():
        return NotIdentifiable(
            "not-free",
            "the person may touch the chair in every sample, and its force is not measured. Use a window in which the "
            "person rises and stands",
            mass,
        )
    if chosen.sum() < LEAST_SECONDS * recorded.rate:
        return NotIdentifiable(
            "too-few-samples",
            f"{chosen.sum() / recorded.rate:.2f} s are usable, expected at least {LEAST_SECONDS:g} s: usable samples "
            f"are off the chair and at least {prepared.lowpass.reach:.2f} s from gaps, which the low-pass spreads. "
            "Record longer or with fewer gaps",
            mass,
        )
    arc = np.degrees(np.max(measure_arcs(recorded.q, chosen)))
    if arc < settings.still_arc_deg:
        if mass is None and _is_contact_excluded(context, movement, recorded.seat is not None):
            mass = float(np.nanmedian(recorded.surroundings[chosen, 1])) / settings.gravity
        result = "nothing" if mass is None else "only the mass"
        return NotIdentifiable(
            "standing-still",
            f"no joint rotates more than {arc:.1f}° while only the ground touches the body, expected at least "
            f"{settings.still_arc_deg:g}°: {result} is known; record a movement",
            mass,
        )
    if not determines_parameters(prepared, movement.free):
        return NotIdentifiable(
            "not-excited",
            "a joint does not move while only the ground touches the body, so the parameters of its two segments "
            "cannot be separated; record a movement of every joint",
            mass,
        )
    return None


def _is_contact_excluded(context: Context, movement: Movement, seat_measured: bool) -> bool:
    """Return whether measurements, and not only assumptions, exclude contacts with unmeasured force."""
    if context.trial.protocol == "robot-joint" or seat_measured:
        return True
    return movement.contact is not None and movement.contact.chair is not None
