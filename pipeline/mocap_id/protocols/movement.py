"""Repetitions of a trial in the plane by protocol, samples for its identification, and averages over repetitions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.preparation import PreparedTrial, TrialData
from mocap_id.protocols.chair_contact import Contact, ContactRule, find_contact, find_samples_off_chair
from mocap_id.protocols.repetitions import Posture, Repetition, compute_posture
from mocap_id.protocols.sit_to_stand import find_sit_to_stand_repetitions
from mocap_id.verdict import Reason

_SIDE = 0.5  # share of half the range: farther from the middle, the joint is on one of the two sides
_LEAST_ARC = np.radians(3.0)  # smallest range of a joint that moves


def find_robot_cycles(time: FloatArray, q: FloatArray) -> tuple[Repetition, ...]:
    """Find the cycles of the joint that moves most: from the middle to one side, the other side and back to the middle.

    ``time`` (T,) are the sample times, s. ``q`` (T, n) are the joint angles, rad; NaN where unknown. Of the times in
    the repetitions, only ``start`` and ``end`` are not NaN.
    """
    known = np.isfinite(q).all(axis=1)
    if known.sum() < 2:
        return ()
    low, high = np.quantile(q[known], [0.01, 0.99], axis=0)
    joint = int(np.argmax(high - low))
    if high[joint] - low[joint] < _LEAST_ARC:
        return ()
    half = (high[joint] - low[joint]) / 2
    swing = (q[known, joint] - (high[joint] + low[joint]) / 2) / half  # scaled so that its range is -1 to 1
    time = time[known]
    side = np.where(swing > _SIDE, 1, np.where(swing < -_SIDE, -1, 0))
    visits = np.flatnonzero(side)
    turns = visits[np.concatenate([[True], np.diff(side[visits]) != 0])]  # first sample of each visit to a side
    middles = []
    for turn in turns:
        before: IntArray = np.flatnonzero(np.sign(swing[:turn]) != np.sign(swing[turn]))
        middles.append(int(before[-1]) if len(before) else 0)
    after: IntArray = np.flatnonzero(np.sign(swing[turns[-1] :]) != np.sign(swing[turns[-1]]))
    if len(after):
        middles.append(int(turns[-1] + after[0]))
    starts = middles[: len(turns) : 2]
    cycles = []
    for k, start in enumerate(starts):
        whole = 2 * k + 2 < len(middles)
        end = middles[2 * k + 2] if whole else len(time) - 1
        why = "" if whole else "the recording ends within the cycle"
        cycles.append(Repetition(float(time[start]), np.nan, np.nan, np.nan, float(time[end]), whole, why))
    return tuple(cycles)


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

    ``prepared`` is the same trial with its regressor; without a measured wrench, it is None, and the posture alone
    gives the repetitions. ``rule``, ``weight_share`` and ``knee_bend`` are as in
    :func:`mocap_id.protocols.chair_contact.find_contact`. ``stands`` is True if the person certainly stands in the
    recording. If not, and if nobody rises in a sit-to-stand trial, the person may be seated all the time, and no sample
    is free.
    """
    everything = np.ones(len(recorded.time), dtype=bool)
    if protocol == "robot-joint":
        return Movement(everything, find_robot_cycles(recorded.time, recorded.q), None, None, (), ~everything)
    if protocol != "sit-to-stand":
        return Movement(everything, (), None, None, (), ~everything)
    body = compute_posture(recorded.q, recorded.dq, recorded.centres)
    if not body.moves:
        seated = recorded.seat is not None
        consequence = "it is not certain that the person stands, so a chair may carry part of the body in every sample"
        if stands:
            consequence = "the person stands, so all samples are used for identification"
        elif seated:
            consequence = "the force of the chair is measured, so all samples are used for identification"
        text = (
            f"no rise was found: the hip moves {100 * body.rise:.1f} cm up and down, too little for a "
            f"sit-to-stand; {consequence}. If the window contains only part of the movement, widen it. For another "
            "movement without a chair, set `protocol: free`"
        )
        free = everything & (stands or seated)
        return Movement(free, (), None, body, (Reason("no-repetitions", text, body.rise),), ~free)
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


def _explain_contact(contact: Contact, requested: ContactRule) -> tuple[Reason, ...]:
    if contact.chair is None:
        text = (
            "chair contact is unknown: the plates were not recorded while the person stands, or while the hips are "
            "low. Samples for identification were selected by the knee angle alone (rule `knee`), as if a chair were "
            "used"
        )
        return (Reason("contact-unknown", text),)
    if not contact.chair:
        text = (
            "the feet carry the whole weight all the time: no chair is used, and all samples are used for "
            "identification"
        )
        return (Reason("no-chair", text, level="ok"),)
    if contact.rule not in (requested, "seat-plate"):
        text = (
            f"the rule `{requested}` needs Fy among the fitted components and enough samples clearly off the chair; "
            f"contact was found from the weight under the feet instead (rule `{contact.rule}`), which misses some "
            "contact"
        )
        return (Reason("contact-rule", text),)
    if contact.converged is False:
        text = (
            "the iteration between the model and the chair contact did not converge; samples with contact in either of "
            "the last two iterations were excluded, unless too few samples would remain"
        )
        return (Reason("contact-unsettled", text),)
    return ()


GRID = np.linspace(0.0, 1.0, 101)


@dataclass(frozen=True)
class Averaged:
    """Mean, standard deviation and number of known repetitions at each point of the cycle, (P,) arrays.

    The standard deviation is NaN for fewer than two repetitions.
    """

    mean: FloatArray
    sd: FloatArray
    count: FloatArray


@dataclass(frozen=True)
class AngleAgreement:
    """Agreement of an angle with the same angle from another system, over the samples where both are known."""

    r: float  # correlation; negative if the two angles have opposite signs
    offset: float  # mean difference, other system minus this program, rad
    rmse: float  # rms difference after removing the offset, rad
    samples: int  # number of samples where both are known


def resample_repetitions(time: FloatArray, values: FloatArray, bounds: FloatArray) -> FloatArray:
    """Return a signal at 0, 1 … 100 % of each repetition, (R, 101); NaN next to missing samples.

    ``values`` (T,) is the signal at ``time`` (T,), s; ``bounds`` (R, 2) are start and end of each repetition, s.
    """
    return interpolate_at(time, values, bounds[:, :1] + (bounds[:, 1:] - bounds[:, :1]) * GRID)


def interpolate_at(time: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Return a signal ``values`` (K,) interpolated at the times ``at``; NaN outside ``time`` (K,) and next to a gap."""
    gap = np.interp(at, time, np.isnan(values).astype(np.float64)) > 0
    return np.where(gap, np.nan, np.interp(at, time, values, np.nan, np.nan))


def average_repetitions(curves: FloatArray) -> Averaged:
    """Average curves (R, P) over the R repetitions; NaN counts as missing."""
    known = np.isfinite(curves)
    count = known.sum(axis=0).astype(np.float64)
    mean = np.where(known, curves, 0.0).sum(axis=0) / np.where(count > 0, count, np.nan)
    square = np.where(known, (curves - mean) ** 2, 0.0).sum(axis=0)
    return Averaged(mean, np.sqrt(square / np.where(count > 1, count - 1, np.nan)), count)


def compare_angles(ours: FloatArray, other: FloatArray) -> AngleAgreement:
    """Compare an angle (T,), rad, with the same angle (T,) from another system; NaN where unknown.

    All numbers except ``samples`` are NaN if fewer than three samples have both angles, or if an angle is constant.
    """
    both = np.isfinite(ours) & np.isfinite(other)
    count = int(both.sum())
    if count < 3 or np.ptp(ours[both]) == 0.0 or np.ptp(other[both]) == 0.0:
        return AngleAgreement(np.nan, np.nan, np.nan, count)
    difference = other[both] - ours[both]
    r = float(np.corrcoef(ours[both], other[both])[0, 1])
    return AngleAgreement(r, float(difference.mean()), float(difference.std()), count)
