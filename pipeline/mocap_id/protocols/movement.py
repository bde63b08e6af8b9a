"""Repetitions of a trial and samples for the identification, found by the protocol of its movement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.preparation import PreparedTrial, TrialData
from mocap_id.protocols.chair_contact import Contact, find_contact
from mocap_id.protocols.contact_rules import ContactRule
from mocap_id.protocols.posture import Posture, posture
from mocap_id.protocols.repetitions import Repetition
from mocap_id.protocols.robot_joint import robot_repetitions
from mocap_id.protocols.sit_to_stand import sit_to_stand_repetitions
from mocap_id.verdict import Reason


@dataclass(frozen=True)
class Movement:
    """Repetitions, contact and usable samples of a trial.

    Parameters
    ----------
    free : (T,) bool array
        Samples without an unmeasured contact force.
    repetitions : tuple of Repetition
    contact : Contact or None
        Chair contact; None if the protocol has no chair or there is no plate.
    posture : Posture or None
        None if the protocol does not use it.
    reasons : tuple of Reason
    """

    free: BoolArray
    repetitions: tuple[Repetition, ...]
    contact: Contact | None
    posture: Posture | None
    reasons: tuple[Reason, ...]


def read_movement(
    protocol: str,
    recorded: TrialData,
    prepared: PreparedTrial | None,
    rule: ContactRule,
    *,
    weight_share: float,
    knee_bend: float,
    stands: bool,
) -> Movement:
    """Find the repetitions and the samples to identify on.

    Parameters
    ----------
    protocol : {"free", "sit-to-stand", "robot-joint"}
    recorded : TrialData
    prepared : PreparedTrial or None
        None without a measured wrench; the repetitions are then found from the posture alone.
    rule, weight_share, knee_bend
        See :func:`mocap_id.protocols.chair_contact.find_contact`.
    stands : bool
        Whether the recording shows that the person stands. If nobody rises in a sit-to-stand trial, a person who is
        not known to stand may be seated throughout, and no sample is free.
    """
    everything = np.ones(len(recorded.time), dtype=bool)
    if protocol == "robot-joint":
        return Movement(everything, robot_repetitions(recorded.time, recorded.q), None, None, ())
    if protocol != "sit-to-stand":
        return Movement(everything, (), None, None, ())
    body = posture(recorded.q, recorded.dq, recorded.centres)
    if not body.moves:
        seated = recorded.seat is not None
        return Movement(everything & (stands or seated), (), None, body, (_no_repetition(body, stands, seated),))
    if prepared is None:
        repetitions = sit_to_stand_repetitions(recorded.time, body, None, chair=True)
        return Movement(everything, repetitions, None, body, ())
    contact = find_contact(prepared, body, rule, weight_share=weight_share, knee_bend=knee_bend)
    repetitions = sit_to_stand_repetitions(recorded.time, body, contact.touching, chair=contact.chair)
    return Movement(contact.free, repetitions, contact, body, _contact_reasons(contact, rule))


def facing(recorded: TrialData) -> int:
    """Return the sign of the plane frame's x axis in front of the person; a bent knee is negative if facing -x."""
    knee: FloatArray = recorded.q[:, min(recorded.knee, recorded.q.shape[1] - 1)]
    return -1 if not np.nanmean(knee) > 0.0 else 1


def _no_repetition(body: Posture, stands: bool, seat_measured: bool) -> Reason:
    consequence = (
        "the person stands, so all samples are used for identification"
        if stands
        else "the force of the chair is measured, so all samples are used for identification"
        if seat_measured
        else "the recording does not show that the person stands, so a chair may carry part of the body in every sample"
    )
    return Reason(
        "no-repetitions",
        f"no rise was found: the hip moves {100 * body.rise:.1f} cm up and down, too little for a "
        f"sit-to-stand; {consequence}. If the window contains only part of the movement, widen it. For another "
        "movement without a chair, set `protocol: free`",
        value=body.rise,
        level="caution",
    )


def _contact_reasons(contact: Contact, requested: ContactRule) -> tuple[Reason, ...]:
    if contact.chair is None:
        reason = Reason(
            "contact-unknown",
            "chair contact is unknown: the plates have no reading while the person stands, or none while the hips "
            "are low. Samples for identification were selected by the knee angle alone (rule `knee`), as if a chair "
            "were used",
        )
    elif not contact.chair:
        reason = Reason(
            "no-chair",
            "the feet carry the whole weight all the time: no chair is used, and all samples are used for "
            "identification",
            level="ok",
        )
    elif contact.rule not in (requested, "seat-plate"):
        reason = Reason(
            "contact-rule",
            f"the rule `{requested}` needs Fy among the fitted components and enough samples clearly off the chair; "
            f"contact was found from the weight under the feet instead (rule `{contact.rule}`), which misses some "
            "contact",
        )
    elif contact.converged is False:
        reason = Reason(
            "contact-unsettled",
            "the iteration between the model and the chair contact did not converge; contact of either of the last two "
            "iterations was excluded, if enough samples remain",
        )
    else:
        return ()
    return (reason,)
