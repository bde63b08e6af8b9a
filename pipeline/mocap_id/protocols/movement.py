"""What a protocol says of a trial: its repetitions, and the samples on which only the ground touches the body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.prepare import Prepared, Recorded
from mocap_id.protocols.contact import ContactRule
from mocap_id.protocols.posture import Posture, posture
from mocap_id.protocols.repetitions import Repetition
from mocap_id.protocols.rising import sit_to_stand_repetitions
from mocap_id.protocols.robot_joint import robot_repetitions
from mocap_id.protocols.sit_to_stand import Contact, find_contact
from mocap_id.verdict import Reason

ProtocolName = Literal["free", "sit-to-stand", "robot-joint"]


@dataclass(frozen=True)
class Movement:
    """A trial read through its protocol.

    Parameters
    ----------
    free : (T,) bool array
        Samples on which nothing touches the body that is not measured.
    repetitions : tuple of Repetition
    contact : Contact or None
        Where the chair is; None where the protocol has none or no plate tells.
    posture : Posture or None
        None where the protocol has no posture.
    reasons : tuple of Reason
    """

    free: BoolArray
    repetitions: tuple[Repetition, ...]
    contact: Contact | None
    posture: Posture | None
    reasons: tuple[Reason, ...]


def read_movement(
    protocol: ProtocolName,
    recorded: Recorded,
    prepared: Prepared | None,
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
    recorded : Recorded
    prepared : Prepared or None
        None where no plate gives a wrench: the repetitions are then found from the posture alone.
    rule, weight_share, knee_bend
        See :func:`mocap_id.protocols.sit_to_stand.find_contact`.
    stands : bool
        The recording shows that the person stands. It decides where nobody rises in a sit-to-stand: without it the
        person may be seated throughout, and no sample is free.
    """
    everything = np.ones(len(recorded.time), dtype=bool)
    if protocol == "robot-joint":
        return Movement(everything, robot_repetitions(recorded.time, recorded.q), None, None, ())
    if protocol == "free":
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
    return Movement(contact.free, repetitions, contact, body, _notes(contact, rule))


def facing(recorded: Recorded) -> int:
    """Sign of the plane frame's x in front of the person: a bent knee is negative facing -x."""
    knee: FloatArray = recorded.q[:, min(1, recorded.q.shape[1] - 1)]
    return -1 if not np.nanmean(knee) > 0.0 else 1


def _no_repetition(body: Posture, stands: bool, seat_measured: bool) -> Reason:
    consequence = (
        "the person stands, and every sample is identified on"
        if stands
        else "what the chair carries is measured, and every sample is identified on"
        if seat_measured
        else "nothing shows that the person stands, so a chair may carry part of the body in every sample"
    )
    return Reason(
        "no-repetitions",
        f"nobody rises here: the highest joint moves {100 * body.rise:.1f} cm up and down, too little for a "
        f"sit-to-stand; {consequence}. If the window holds only a part of the movement, widen it; if the movement is "
        "another and without a chair, set `protocol: free`",
        value=body.rise,
        level="caution",
    )


def _notes(contact: Contact, asked: ContactRule) -> tuple[Reason, ...]:
    if contact.chair is None:
        return (
            Reason(
                "contact-unknown",
                "the plates do not show where a chair carries part of the body: they have no reading while the person "
                "stands, or none in any low phase. What is identified on was chosen by the knee alone (`knee`), as if "
                "a chair were used",
            ),
        )
    if not contact.chair:
        return (
            Reason(
                "no-chair",
                "the feet carry the whole weight all the time: no chair is used, and every sample is identified on",
                level="ok",
            ),
        )
    if contact.rule not in (asked, "seat-plate"):
        return (
            Reason(
                "contact-rule",
                f"the rule `{asked}` needs Fy among the fitted components and enough samples that are surely off the "
                "chair; the chair's contact was found from the weight under the feet instead "
                f"(`{contact.rule}`), which lets some contact through",
            ),
        )
    if contact.converged is False:
        return (
            Reason(
                "contact-unsettled",
                "the model and the chair's contact that it shows did not come to agree with each other; what either of "
                "the last two rounds calls contact was left out, as far as enough is left to identify on",
            ),
        )
    return ()
