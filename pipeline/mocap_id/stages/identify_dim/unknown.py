"""Why nothing could be identified from a trial, said before anything is fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.dynamics.fit import determined, select
from mocap_id.dynamics.folds import LEAST_SECONDS
from mocap_id.dynamics.prepare import Prepared, Recorded, arcs
from mocap_id.protocols.movement import Movement
from mocap_id.stages.base import Context


@dataclass(frozen=True)
class Unknown:
    """Why nothing could be identified, and the mass where that much is known."""

    code: str
    why: str
    mass: float | None = None


def without_wrench(context: Context, recorded: Recorded) -> Unknown | None:
    """Why there is nothing to identify from, before any computation."""
    facts = context.table("wrench.parquet").facts
    felt = np.isfinite(recorded.surroundings).all(axis=1)
    if not felt.any():
        why = facts.get("why") or "the recording has no usable force plate"
        return Unknown("no-wrench", f"the inertial parameters need the ground's wrench: {why}")
    known = np.isfinite(recorded.ddq).all(axis=1)
    if (felt & known).sum() < LEAST_SECONDS * recorded.rate:
        return Unknown(
            "no-common-samples",
            f"wrench and joint angles are known together in {(felt & known).sum() / recorded.rate:.2f} s, "
            f"expected at least {LEAST_SECONDS:g} s",
            facts.get("mass_kg"),
        )
    return None


def not_excited(context: Context, prepared: Prepared, movement: Movement) -> Unknown | None:
    """Why the samples that are left say nothing of the parameters."""
    settings, recorded = context.settings, prepared.recorded
    chosen = select(prepared, movement.free)
    mass = context.table("wrench.parquet").facts.get("mass_kg")
    if not movement.free.any():
        return Unknown(
            "not-free",
            "in no sample is it known that the ground alone touches the body: what a chair carries is not measured. "
            "Use a window in which the person rises and stands",
            mass,
        )
    if chosen.sum() < LEAST_SECONDS * recorded.rate:
        return Unknown(
            "too-few-samples",
            f"{chosen.sum() / recorded.rate:.2f} s are left to identify on, off the chair and clear of gaps by the "
            f"filter's reach of {prepared.lowpass.reach:.2f} s; expected at least {LEAST_SECONDS:g} s: record longer "
            "or with fewer gaps",
            mass,
        )
    arc = np.degrees(np.max(arcs(recorded.q, chosen)))
    if arc < settings.still_arc_deg:
        if mass is None and _known_to_be_free(context, movement, recorded.seat is not None):
            mass = float(np.nanmedian(recorded.surroundings[chosen, 1])) / settings.gravity
        shown = "nothing" if mass is None else "only the mass"
        return Unknown(
            "standing-still",
            f"no joint turns more than {arc:.1f}° where only the ground touches the body, expected at least "
            f"{settings.still_arc_deg:g}°: {shown} is known; record a movement",
            mass,
        )
    if not determined(prepared, movement.free):
        return Unknown(
            "not-excited",
            "where only the ground touches the body, a joint rests and its segment's parameters cannot be told from "
            "the others'; record a movement of every joint",
            mass,
        )
    return None


def _known_to_be_free(context: Context, movement: Movement, seat_measured: bool) -> bool:
    """Whether the samples to identify on are shown, not only taken, to have no unmeasured contact."""
    if context.trial.protocol == "robot-joint" or seat_measured:
        return True
    return movement.contact is not None and movement.contact.chair is not None
