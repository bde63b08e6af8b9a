"""Repetitions of a trial in the plane, and the samples for its identification, by protocol."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.preparation import PreparedTrial, TrialData
from mocap_id.protocols.chair_contact import Contact, find_contact
from mocap_id.protocols.contact_rules import ContactRule, find_samples_off_chair
from mocap_id.protocols.posture import Posture, compute_posture
from mocap_id.protocols.repetitions import Repetition
from mocap_id.protocols.robot_joint import find_robot_cycles
from mocap_id.protocols.sit_to_stand import find_sit_to_stand_repetitions
from mocap_id.verdict import Reason


@dataclass(frozen=True)
class Movement:
    """Repetitions, contact and usable samples of a trial."""

    free: BoolArray  # (T,) samples without an unmeasured contact force
    repetitions: tuple[Repetition, ...]  # repetitions in order of time; empty for ``protocol: free``
    contact: Contact | None  # chair contact; None if the protocol has no chair or the trial has no plate
    posture: Posture | None  # height of the hip over time; None for other protocols than sit-to-stand
    reasons: tuple[Reason, ...]  # cautions and notes about repetitions and contact
    # (T,) samples in which a chair whose force is not measured carries, or may carry, part of the body
    carried: BoolArray


def find_movement(
    protocol: str,
    recorded: TrialData,
    prepared: PreparedTrial | None,
    rule: ContactRule,
    *,
    weight_share: float,
    knee_bend: float,
    stands: bool,
) -> Movement:
    """Find the repetitions of a trial and the samples for its identification.

    Parameters
    ----------
    protocol : {"free", "sit-to-stand", "robot-joint"}
        Protocol of the trial.
    prepared : PreparedTrial or None
        The same trial with its regressor; None without a measured wrench. The posture alone then gives the repetitions.
    rule, weight_share, knee_bend
        Rule for chair contact and its thresholds; see :func:`mocap_id.protocols.chair_contact.find_contact`.
    stands : bool
        True if the person certainly stands in the recording. If this is False and nobody rises in a sit-to-stand
        trial, the person may be seated all the time, and no sample is free.
    """
    everything = np.ones(len(recorded.time), dtype=bool)
    if protocol == "robot-joint":
        return Movement(everything, find_robot_cycles(recorded.time, recorded.q), None, None, (), ~everything)
    if protocol != "sit-to-stand":
        return Movement(everything, (), None, None, (), ~everything)
    body = compute_posture(recorded.q, recorded.dq, recorded.centres)
    if not body.moves:
        seated = recorded.seat is not None
        reasons = (_describe_missing_rise(body, stands, seated),)
        free = everything & (stands or seated)
        return Movement(free, (), None, body, reasons, ~free)
    if prepared is None:
        repetitions = find_sit_to_stand_repetitions(recorded.time, body, None, chair=True)
        return Movement(everything, repetitions, None, body, (), ~find_samples_off_chair(body))
    contact = find_contact(prepared, body, rule, weight_share=weight_share, knee_bend=knee_bend)
    repetitions = find_sit_to_stand_repetitions(recorded.time, body, contact.touching, chair=contact.chair)
    return Movement(contact.free, repetitions, contact, body, _explain_contact(contact, rule), contact.carried)


def find_facing(recorded: TrialData) -> int:
    """Return 1 if the person faces x in the plane's axes, else -1; this is the sign of the mean knee angle."""
    knee: FloatArray = recorded.q[:, min(recorded.knee, recorded.q.shape[1] - 1)]
    known = knee[np.isfinite(knee)]
    return 1 if len(known) and known.mean() > 0.0 else -1


def _describe_missing_rise(body: Posture, stands: bool, seat_measured: bool) -> Reason:
    if stands:
        consequence = "the person stands, so all samples are used for identification"
    elif seat_measured:
        consequence = "the force of the chair is measured, so all samples are used for identification"
    else:
        consequence = "it is not certain that the person stands, so a chair may carry part of the body in every sample"
    return Reason(
        "no-repetitions",
        f"no rise was found: the hip moves {100 * body.rise:.1f} cm up and down, too little for a "
        f"sit-to-stand; {consequence}. If the window contains only part of the movement, widen it. For another "
        "movement without a chair, set `protocol: free`",
        value=body.rise,
        level="caution",
    )


def _explain_contact(contact: Contact, requested: ContactRule) -> tuple[Reason, ...]:
    if contact.chair is None:
        reason = Reason(
            "contact-unknown",
            "chair contact is unknown: the plates were not recorded while the person stands, or while the hips are "
            "low. Samples for identification were selected by the knee angle alone (rule `knee`), as if a chair were "
            "used",
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
            "the iteration between the model and the chair contact did not converge; samples with contact in either of "
            "the last two iterations were excluded, unless too few samples would remain",
        )
    else:
        return ()
    return (reason,)
