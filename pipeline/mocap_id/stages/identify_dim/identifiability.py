"""Checks before the fit whether parameters can be identified from a trial."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.dynamics.fit import determines_parameters
from mocap_id.dynamics.preparation import PreparedTrial, TrialData, measure_arcs
from mocap_id.dynamics.sample_choice import LEAST_SECONDS, select_samples
from mocap_id.protocols.movement import Movement
from mocap_id.stages.base import Context


@dataclass(frozen=True)
class NotIdentifiable:
    """Code and text of the reason why nothing can be identified; ``mass`` is the mass, kg, or None if unknown."""

    code: str
    why: str
    mass: float | None = None


def check_wrench(context: Context, recorded: TrialData) -> NotIdentifiable | None:
    """Return the reason why the data do not suffice for an identification; None if they do."""
    facts = context.table("wrench.parquet").facts
    measured = np.isfinite(recorded.surroundings).all(axis=1)
    if not measured.any():
        why = facts.get("why") or "the recording has no usable force plate"
        return NotIdentifiable("no-wrench", f"the inertial parameters need the ground's wrench: {why}")
    known = np.isfinite(recorded.ddq).all(axis=1)
    if (measured & known).sum() < LEAST_SECONDS * recorded.rate:
        return NotIdentifiable(
            "no-common-samples",
            f"wrench and joint angles are both known for {(measured & known).sum() / recorded.rate:.2f} s, expected at "
            f"least {LEAST_SECONDS:g} s",
            facts.get("mass_kg"),
        )
    return None


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
