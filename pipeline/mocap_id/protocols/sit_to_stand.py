"""Sit-to-stand and squats: where the chair is (thesis ch. 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray
from mocap_id.dynamics.external import SEAT
from mocap_id.dynamics.fit import determined, fit
from mocap_id.dynamics.lowpass import LowPass, runs
from mocap_id.dynamics.prepare import Prepared
from mocap_id.protocols import contact
from mocap_id.protocols.contact import ContactRule, DecidingRule
from mocap_id.protocols.posture import Posture

_ROUNDS = 8
_SETTLED = 0.02  # s: contact that moves by no more does not matter, the filter's reach is ten times that


@dataclass(frozen=True)
class Contact:
    """Where the chair is.

    Parameters
    ----------
    chair : bool or None
        A chair is used; False for squats, None where the plates do not tell.
    touching : (T,) bool array or None
        Samples with contact, on the markers' clock; None where the plates do not tell.
    free : (T,) bool array
        Samples to identify on.
    weight : float
        Standing weight, N.
    threshold : float or None
        Missing vertical force that counted as contact, N; None where the rule was another.
    rule : DecidingRule
        The rule that decided: the chair's own plate where there is one; another than asked for where that one had too
        little to go by.
    converged : bool or None
        The contact and the model that shows it agree with each other; None where the rule was another.
    shown : (T,) bool array or None
        Samples where the chair's force stands out of the noise: ``touching`` goes on from there to where it vanishes.
        None where the rule was another.
    """

    chair: bool | None
    touching: BoolArray | None
    free: BoolArray
    weight: float
    threshold: float | None
    rule: DecidingRule
    converged: bool | None = None
    shown: BoolArray | None = None


def find_contact(
    prepared: Prepared, posture: Posture, rule: ContactRule, *, weight_share: float, knee_bend: float
) -> Contact:
    """Find the samples without chair contact.

    Parameters
    ----------
    prepared : Prepared
    posture : Posture
    rule : {"seat-force", "weight", "knee"}
        See :mod:`mocap_id.protocols.contact`.
    weight_share : float
        Share of the standing weight that releases the chair, rule ``weight``.
    knee_bend : float
        Bend of the second joint, rad, below which the person is off the chair, rule ``knee``.
    """
    if prepared.recorded.seat is not None:
        return by_seat_plate(prepared, posture)
    vertical = prepared.recorded.surroundings[:, 1]
    weight = contact.standing_weight(posture, vertical)
    chair = contact.uses_chair(posture, vertical, weight)
    if chair is False:
        nowhere = np.zeros(len(vertical), dtype=bool)
        return Contact(False, nowhere, ~nowhere, weight, None, rule)
    with np.errstate(invalid="ignore"):
        by_weight = contact.touching(posture, vertical < weight_share * weight)
        straight = np.abs(prepared.recorded.q[:, min(1, prepared.recorded.q.shape[1] - 1)]) < knee_bend
    if chair is None:
        return Contact(None, None, straight, weight, None, "knee")
    if rule == "knee":
        return Contact(True, by_weight, straight, weight, None, rule)
    first = contact.surely_free(posture) & ~by_weight
    # the seat's force is what the feet lack in Fy: a model that was not fitted to it does not know that
    if rule == "weight" or 1 not in prepared.settings.components or not determined(prepared, first):
        return Contact(True, by_weight, ~by_weight, weight, None, "weight")
    return _by_seat_force(prepared, posture, first, weight)


def by_seat_plate(prepared: Prepared, posture: Posture) -> Contact:
    """Contact as the chair's own plate shows it; every sample is free to identify on, since nothing is unmeasured."""
    everything = np.ones(len(prepared.recorded.time), dtype=bool)
    offset = fit(prepared, everything).offset if determined(prepared, everything) else 0.0
    seat = prepared.external(offset)[[each.name for each in prepared.recorded.external].index(SEAT)][:, 1]
    weight = contact.standing_weight(posture, prepared.measured(offset)[:, 1])
    if np.isnan(weight):  # nobody is seen to stand: what both plates carry together is the weight
        weight = float(np.nanmedian(prepared.recorded.surroundings[:, 1]))
    threshold = contact.seat_force_threshold(seat, posture.upright, weight)
    with np.errstate(invalid="ignore"):
        shown = contact.touching(posture, seat > threshold)
        touching = contact.until_zero(prepared.recorded.time, shown, seat)
    return Contact(bool(touching.any()), touching, everything, weight, threshold, "seat-plate", shown=shown)


def _by_seat_force(prepared: Prepared, posture: Posture, first: BoolArray, weight: float) -> Contact:
    """Alternate between a model of what is surely free and the contact that it shows, until neither changes.

    Where they do not settle, what either of the last two rounds calls contact is left out. A round whose free samples
    would not determine a model ends the search too, with the contact before it.
    """
    rate = prepared.recorded.rate
    smooth = LowPass(min(2 * prepared.lowpass.cutoff, 10.0, rate / 5), rate)
    free, before, touching, threshold, converged = first, ~first, ~first, 0.0, False
    missing = np.full(len(first), np.nan)
    for _ in range(_ROUNDS):
        found = fit(prepared, free)
        base = found.problem.free_solution()[: found.base]
        measured = prepared.measured(found.offset)[:, 1]
        missing = prepared.rows[:, 1] @ base - measured
        seat_force = smooth(missing[:, None])[:, 0]
        threshold = contact.seat_force_threshold(seat_force, found.in_fit, weight)
        with np.errstate(invalid="ignore"):
            shown = contact.touching(posture, seat_force > threshold)
        if not determined(prepared, ~shown):
            break
        before, touching, free = touching, shown, ~shown
        converged = all(run.stop - run.start <= _SETTLED * rate for run in runs(before ^ touching))
        if converged:
            break
    if not converged and determined(prepared, ~(touching | before)):
        touching = touching | before
    longer = contact.until_zero(prepared.recorded.time, touching, missing)
    longer = longer if determined(prepared, ~longer) else touching
    return Contact(True, longer, ~longer, weight, threshold, "seat-force", converged, touching)
