"""Movement of a trial: its repetitions by protocol, averages over them, and the kind of movement in a recording."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.anatomy.landmarks import SEGMENTS, Side, find_landmarks, find_roles
from mocap_id.arrays import BoolArray, FloatArray, IntArray, find_runs
from mocap_id.dynamics.preparation import PreparedTrial, TrialData
from mocap_id.kinematics.base_motion import find_base_motion, propose_window
from mocap_id.protocols.repetitions import Posture, Repetition, compute_posture
from mocap_id.protocols.sit_to_stand import (
    Contact,
    ContactRule,
    find_contact,
    find_samples_off_chair,
    find_sit_to_stand_repetitions,
)
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
    :func:`mocap_id.protocols.sit_to_stand.find_contact`. ``stands`` is True if the person certainly stands in the
    recording. If not, and if nobody rises in a sit-to-stand trial, the person may be seated all the time, and no sample
    is free.
    """
    everything = np.ones(len(recorded.time), dtype=bool)
    if protocol == "robot-joint":
        return Movement(everything, find_robot_cycles(recorded.time, recorded.q), None, None, (), ~everything)
    if protocol != "sit-to-stand":
        return Movement(everything, (), None, None, (), ~everything)
    posture = compute_posture(recorded.q, recorded.dq, recorded.centres)
    if not posture.moves:
        seated = recorded.seat is not None
        consequence = "it is not certain that the person stands, so a chair may carry part of the body in every sample"
        if stands:
            consequence = "the person stands, so all samples are used for identification"
        elif seated:
            consequence = "the force of the chair is measured, so all samples are used for identification"
        text = (
            f"no rise was found: the hip moves {100 * posture.rise:.1f} cm up and down, too little for a "
            f"sit-to-stand; {consequence}. If the window contains only part of the movement, widen it. For another "
            "movement without a chair, set `protocol: free`"
        )
        free = everything & (stands or seated)
        return Movement(free, (), None, posture, (Reason("no-repetitions", text, posture.rise),), ~free)
    if prepared is None:
        repetitions = find_sit_to_stand_repetitions(recorded.time, posture, None, chair=True)
        return Movement(everything, repetitions, None, posture, (), ~find_samples_off_chair(posture))
    contact = find_contact(prepared, posture, rule, weight_share=weight_share, knee_bend=knee_bend)
    repetitions = find_sit_to_stand_repetitions(recorded.time, posture, contact.touching, chair=contact.chair)
    reasons: tuple[Reason, ...] = ()
    if contact.chair is None:
        text = (
            "chair contact is unknown: the plates were not recorded while the person stands, or while the hips are "
            "low. Samples for identification were selected by the knee angle alone (rule `knee`), as if a chair were "
            "used"
        )
        reasons = (Reason("contact-unknown", text),)
    elif not contact.chair:
        text = (
            "the feet carry the whole weight all the time: no chair is used, and all samples are used for "
            "identification"
        )
        reasons = (Reason("no-chair", text, level="ok"),)
    elif contact.rule not in (rule, "seat-plate"):
        text = (
            f"the rule `{rule}` needs Fy among the fitted components and enough samples clearly off the chair; "
            f"contact was found from the weight under the feet instead (rule `{contact.rule}`), which misses some "
            "contact"
        )
        reasons = (Reason("contact-rule", text),)
    elif contact.converged is False:
        text = (
            "the iteration between the model and the chair contact did not converge; samples with contact in either of "
            "the last two iterations were excluded, unless too few samples would remain"
        )
        reasons = (Reason("contact-unsettled", text),)
    return Movement(contact.free, repetitions, contact, posture, reasons, contact.carried)


def find_facing(recorded: TrialData) -> int:
    """Return 1 if the person faces x in the plane's axes, else -1; this is the sign of the mean knee angle."""
    knee: FloatArray = recorded.q[:, min(recorded.knee, recorded.q.shape[1] - 1)]
    known = knee[np.isfinite(knee)]
    return 1 if len(known) and known.mean() > 0.0 else -1


GRID = np.linspace(0.0, 1.0, 101)


def resample_repetitions(time: FloatArray, values: FloatArray, bounds: FloatArray) -> FloatArray:
    """Return a signal at 0, 1 … 100 % of each repetition, (R, 101); NaN next to missing samples.

    ``values`` (T,) is the signal at ``time`` (T,), s; ``bounds`` (R, 2) are start and end of each repetition, s.
    """
    return interpolate_at(time, values, bounds[:, :1] + (bounds[:, 1:] - bounds[:, :1]) * GRID)


def interpolate_at(time: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Return a signal ``values`` (K,) interpolated at the times ``at``; NaN outside ``time`` (K,) and next to a gap."""
    gap = np.interp(at, time, np.isnan(values).astype(np.float64)) > 0
    return np.where(gap, np.nan, np.interp(at, time, values, np.nan, np.nan))


def average_repetitions(curves: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, standard deviation and number of the known values of curves (R, P) over the repetitions, (P,).

    The standard deviation is NaN for fewer than two repetitions.
    """
    known = np.isfinite(curves)
    count = known.sum(axis=0).astype(np.float64)
    mean = np.where(known, curves, 0.0).sum(axis=0) / np.where(count > 0, count, np.nan)
    square = np.where(known, (curves - mean) ** 2, 0.0).sum(axis=0)
    return mean, np.sqrt(square / np.where(count > 1, count - 1, np.nan)), count


def compare_angles(ours: FloatArray, other: FloatArray) -> tuple[float, float, float, int]:
    """Compare an angle (T,), rad, with the same angle (T,) from another system; NaN where unknown.

    Return the correlation, negative if the angles have opposite signs; the mean difference, other minus ours, rad; the
    rms difference without it, rad; and the number of samples with both angles. All but the last are NaN if fewer than
    three samples have both angles, or if an angle is constant.
    """
    both = np.isfinite(ours) & np.isfinite(other)
    count = int(both.sum())
    if count < 3 or np.ptp(ours[both]) == 0.0 or np.ptp(other[both]) == 0.0:
        return np.nan, np.nan, np.nan, count
    difference = other[both] - ours[both]
    r = float(np.corrcoef(ours[both], other[both])[0, 1])
    return r, float(difference.mean()), float(difference.std()), count


Kind: TypeAlias = Literal["sit-to-stand", "walking", "jumping", "reach", "curl", "still", "one-body", "unknown"]

# Limits as shares of the height of the set of markers
_STILL = 0.035  # a marker stands if it stays within this range, and within _STILL_M
_LOW = 0.2  # markers up to here may be on the feet
_LEGS = (0.15, 0.6)  # markers on the legs; a third of them move in a sit-to-stand
_UPPER = 0.45  # markers above are on pelvis, trunk, head or arms
_RISES = 0.09  # least rise of the trunk
_BESIDE = 0.5  # largest horizontal distance of the trunk from the feet; in a chair it is about a third
_TRAVELS = 0.8  # least way of a body that travels
_STEPS = 0.25  # least way of the feet on a treadmill, and largest way of the trunk
_LIFTED = 0.03  # least rise of feet and trunk in a jump
_RIGID = 0.012  # largest standard deviation of a distance in one rigid body
# Other limits
_ENOUGH_HZ = 50.0  # frames per second that show a jump
_SEEN = 0.3  # least share of the frames in which a marker is visible
_STILL_M = 0.05
_TOGETHER = 0.6  # least share of the upper markers that rise with the trunk
_STOP, _GO = 0.4, 1.25  # speed of a foot that stands and of one that swings, as shares of the body's speed
_ALTERNATE = -0.3  # correlation between the ways of the two feet on a treadmill; about -0.8 in walking
_FLIGHT_S = (0.08, 1.0)
_FALLS = (-13.0, -6.0)  # m/s², vertical acceleration of a body in free flight
_REACHES_M = 0.1  # least way of the wrist
_TRUNK_STAYS, _ELBOW_STAYS = 0.5, 0.3  # largest ways of the thorax, and of the elbow in curls, as shares of the wrist's
_ARM, _THORAX = {"EL", "EM", "RS", "US"}, ("IJ", "PX", "C7", "T8")
_SIDES: tuple[Side, ...] = ("right", "left")

ELSEWHERE = {
    "walking": "For gait, use a program for gait analysis, such as the gait model of the camera software or OpenSim: "
    "it finds heel strike and toe-off, lets the pelvis move freely, and gives the angles and moments of each leg",
    "jumping": "For jumps, use a program for force plates: it gives height, power and impulse. For joint moments, use "
    "one that lets the pelvis move freely, such as OpenSim",
}
"""Advice for movements without a base that stands."""


Recognised: TypeAlias = tuple[Kind, str]
"""Kind of movement in a recording, and what was seen, as a clause."""


def recognise_movement(labels: Sequence[str], positions: FloatArray, rate: float) -> Recognised:
    """Return the kind of movement that the markers show, and what was seen.

    The kinds are ``sit-to-stand`` (also squats and lifts: feet that stand under a trunk that goes up and down),
    ``walking``, ``jumping``, ``reach`` and ``curl`` (landmarks of an arm that moves beside a thorax that stays),
    ``still``, ``one-body`` (a single rigid body moves, such as the link of a robot) and ``unknown``. ``positions``
    (F, M, 3) are in lab axes with Z up, m; NaN if not visible. ``rate`` is in frames per second.
    """
    step = max(1, int(rate / _ENOUGH_HZ))
    positions, rate = positions[::step], rate / step
    with warnings.catch_warnings():
        # markers that are hidden for a while
        warnings.filterwarnings("ignore", "All-NaN|Mean of empty", RuntimeWarning)
        part = positions[slice(*propose_window(positions, rate))]
        seen = np.isfinite(part).all(axis=2).sum(axis=0) > _SEEN * len(part)
        if seen.sum() < 2 or len(part) < 4:
            return "unknown", "too few markers are visible"
        tracks = _Tracks([label for label, kept in zip(labels, seen, strict=True) if kept], part[:, seen], rate)
        if np.percentile(tracks.way, 90) < _STILL * tracks.height:
            return "still", f"no marker moves farther than {100 * tracks.way.max():.0f} cm"
        found = _find_steps(tracks) or _find_flight(tracks)
        if found is not None:
            return found
        time = np.arange(len(part)) / rate
        base = find_base_motion(part, time, rate)
        if base is not None:  # feet that stand, step and stand again
            tracks = _Tracks(tracks.labels, base.undo_positions(part, time)[:, seen], rate)
        return _find_one_body(tracks) or _find_rise(tracks) or _recognise_arm(tracks)


class _Tracks:
    """Markers (F, M, 3), lab axes with Z up, m, with their ranges; 2 % of the frames at either end do not count."""

    def __init__(self, labels: Sequence[str], points: FloatArray, rate: float) -> None:
        self.labels, self.points, self.rate = labels, points, rate
        low, high = np.nanpercentile(points, [2, 98], axis=0)
        self.range = high - low  # (M, 3) range of every marker along the axes, m
        self.way = np.linalg.norm(self.range, axis=1)  # (M,) range of every marker, m
        self.across = np.hypot(self.range[:, 0], self.range[:, 1])  # (M,) horizontal range of every marker, m
        self.middle = np.nanmedian(points, axis=0)  # (M, 3) median position of every marker, m
        self.height = high[:, 2].max() - low[:, 2].min()  # height of the set of markers, m
        # height of every marker above the lowest one, as share of the height of the set
        self.above = (self.middle[:, 2] - self.middle[:, 2].min()) / self.height


def _find_steps(tracks: _Tracks) -> Recognised | None:
    """Return walking if the feet stop and go while the body travels, or alternate under a trunk that stays."""
    points, low = tracks.points, tracks.above < _LOW
    if np.median(tracks.across) > _TRAVELS * tracks.height:
        block = max(1, round(0.1 * tracks.rate))
        speed = np.linalg.norm(points[block:, :, :2] - points[:-block, :, :2], axis=2)
        body = np.nanmedian(speed, axis=1)
        goes = body > 0.5 * np.nanmedian(body)
        share = speed[goes][:, low] / body[goes, None]
        if ((np.mean(share < _STOP, axis=0) > 0.1) & (np.mean(share > _GO, axis=0) > 0.1)).sum() < 2:
            return None
        text = f"the body travels by {np.median(tracks.across):.1f} m, and the feet stand and swing in turn"
        return "walking", text
    stepping, upper = low & (tracks.across > _STEPS * tracks.height), tracks.above > _UPPER
    if stepping.sum() < 2 or not upper.any() or np.median(tracks.across[upper]) > _STEPS * tracks.height:
        return None
    plan = points[:, stepping, :2] - np.nanmean(points[:, stepping, :2], axis=0)
    forwards = np.linalg.svd(np.nan_to_num(plan).reshape(-1, 2), full_matrices=False)[2][0]
    if np.corrcoef(np.nan_to_num(plan @ forwards), rowvar=False).min() > _ALTERNATE:
        return None
    text = "the feet move forwards and backwards in turn under a trunk that stays, as on a treadmill"
    return "walking", text


def _find_flight(tracks: _Tracks) -> Recognised | None:
    """Return jumping if all markers near the ground and the trunk rise together and the body falls freely."""
    heights, low, upper = tracks.points[..., 2], tracks.above < _LOW, tracks.above > _UPPER
    feet = heights[:, low] - np.nanpercentile(heights[:, low], 10, axis=0)
    trunk = heights[:, upper] - tracks.middle[upper, 2]
    off = np.isfinite(feet).sum(axis=1) * 2 > low.sum()
    off &= np.nanmin(feet, axis=1, initial=np.inf) > _LIFTED * tracks.height
    off &= np.nanmedian(trunk, axis=1) > _LIFTED * tracks.height
    for run in find_runs(off):
        body = heights[run.start : run.stop]
        body = body[:, np.isfinite(body).all(axis=0)]
        seconds = np.arange(len(body)) / tracks.rate
        if low.sum() < 2 or len(body) < 4 or not body.size or not _FLIGHT_S[0] <= seconds[-1] <= _FLIGHT_S[1]:
            continue
        if _FALLS[0] < 2 * np.polyfit(seconds, body.mean(axis=1), 2)[0] < _FALLS[1]:
            text = f"all markers near the ground leave it together, and the body falls freely for {seconds[-1]:.2f} s"
            return "jumping", text
    return None


def _find_one_body(tracks: _Tracks) -> Recognised | None:
    """Return one-body if the markers that move, at least three, keep all their distances beside markers that stand."""
    moving = tracks.way > _STILL * tracks.height
    if moving.sum() < 3 or (~moving).sum() < 2:
        return None
    some = tracks.points[:: max(1, len(tracks.points) // 200), moving]
    apart = np.linalg.norm(some[:, :, None] - some[:, None], axis=3)
    spread = np.subtract(*np.nanpercentile(apart, [95, 5], axis=0)) / 3.3
    if np.nanmax(spread) > _RIGID * tracks.height:
        return None
    return "one-body", f"the {int(moving.sum())} markers that move are one rigid body"


def _find_rise(tracks: _Tracks) -> Recognised | None:
    """Return sit-to-stand if feet stand under legs that bend and a trunk that goes up and down."""
    up, above, middle = tracks.range[:, 2], tracks.above, tracks.middle
    stands = (above < _LOW) & (tracks.way < min(_STILL * tracks.height, _STILL_M))
    legs = (above > _LEGS[0]) & (above < _LEGS[1])
    bends = legs & (tracks.way > _STILL * tracks.height)
    rising = (above > _UPPER) & (up > _STILL * tracks.height)
    if stands.sum() < 2 or bends.sum() < max(1, legs.sum() / 3) or not rising.any():
        return None
    mean = np.nanmedian(tracks.points[:, rising, 2] - middle[rising, 2], axis=1)
    rise = float(np.subtract(*np.nanpercentile(mean, [98, 2])))
    landmarks, roles = find_landmarks(tracks.labels).markers, find_roles(tracks.labels, "right")
    trunk = [landmarks[name] for name in _THORAX if name in landmarks]
    trunk += [roles[name] for name in ("spine_top", "neck") if name in roles]
    with_it: BoolArray = up > 0.5 * rise
    beside = float(np.linalg.norm(middle[stands, :2].mean(axis=0) - np.median(middle[rising, :2], axis=0)))
    if (
        rise < _RISES * tracks.height
        or with_it[above > _UPPER].mean() < _TOGETHER
        or not with_it[[int(np.argmax(above)), *trunk]].all()
        or beside > _BESIDE * tracks.height
    ):
        return None
    return (
        "sit-to-stand",
        f"{int(stands.sum())} markers near the ground stand, and the trunk goes up and down by {100 * rise:.0f} cm",
    )


def _recognise_arm(tracks: _Tracks) -> Recognised:
    """Return reach or curl if landmarks or joints of an arm move beside a thorax that stays, else unknown."""
    if any("wheel" in label.lower() for label in tracks.labels):
        return "unknown", "the markers name a wheel, and no protocol is for wheelchairs"
    landmarks = find_landmarks(tracks.labels).markers
    arms = [find_roles(tracks.labels, side) for side in _SIDES]
    roles = max(arms, key=lambda arm: tracks.way[arm["wrist"]] if "wrist" in arm else 0.0)
    if landmarks.keys() >= _ARM:
        wrist, elbow = [landmarks["RS"], landmarks["US"]], [landmarks["EL"], landmarks["EM"]]
        thorax = [landmarks[name] for name in _THORAX if name in landmarks]
    elif {"wrist", "elbow", "near_shoulder"} <= roles.keys():
        wrist, elbow = [roles["wrist"]], [roles["elbow"]]
        thorax = [roles[name] for name in ("spine_top", "neck", "near_shoulder", "far_shoulder") if name in roles]
    else:
        known = ", ".join(name for name in landmarks if name in SEGMENTS)
        return (
            "unknown",
            "no feet stand under a trunk that goes up and down, no feet step or leave the ground, and the names of the "
            f"markers are not those of a whole arm{f' (only {known})' if known else ''}",
        )
    ways = np.linalg.norm(np.subtract(*np.nanpercentile(tracks.points, [95, 5], axis=0)), axis=1)
    far, bends, stays = (float(np.median(ways[at])) if at else 0.0 for at in (wrist, elbow, thorax))
    text = f"the wrist moves by {100 * far:.0f} cm, elbow and thorax by {100 * bends:.0f} and {100 * stays:.0f} cm"
    if far < _REACHES_M or stays > _TRUNK_STAYS * far:
        return "unknown", f"an arm is named, but {text}"
    return "curl" if bends < _ELBOW_STAYS * far else "reach", text
