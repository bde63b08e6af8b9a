"""Recognition of the kind of movement in a recording, from the motion of its markers.

Most lengths are compared with the height of the set of markers, so that a child, a leg alone and a file with a wrong
unit are treated alike.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.anatomy.names import SEGMENTS, Side, find_landmarks, find_roles
from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.kinematics import propose_window
from mocap_id.kinematics.base_motion import find_base_motion

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


@dataclass(frozen=True)
class RecognisedMovement:
    """The kind of movement in a recording, and what shows it."""

    kind: Kind
    evidence: str  # what was seen, as a clause


def recognise_movement(labels: Sequence[str], positions: FloatArray, rate: float) -> RecognisedMovement:
    """Return the kind of movement that the markers show.

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
            return RecognisedMovement("unknown", "too few markers are visible")
        tracks = _Tracks.of([label for label, kept in zip(labels, seen, strict=True) if kept], part[:, seen], rate)
        if np.percentile(tracks.way, 90) < _STILL * tracks.height:
            return RecognisedMovement("still", f"no marker moves farther than {100 * tracks.way.max():.0f} cm")
        found = _find_steps(tracks) or _find_flight(tracks)
        if found is not None:
            return found
        time = np.arange(len(part)) / rate
        base = find_base_motion(part, time, rate)
        if base is not None:  # feet that stand, step and stand again
            tracks = _Tracks.of(tracks.labels, base.undo_positions(part, time)[:, seen], rate)
        return _find_one_body(tracks) or _find_rise(tracks) or _recognise_arm(tracks)


@dataclass(frozen=True)
class _Tracks:
    """Markers with their ranges; 2 % of the frames at either end do not count."""

    labels: Sequence[str]
    points: FloatArray  # (F, M, 3) lab axes with Z up, m
    rate: float  # frames per second
    range: FloatArray  # (M, 3) range of every marker along the axes, m
    way: FloatArray  # (M,) range of every marker, m
    across: FloatArray  # (M,) horizontal range of every marker, m
    middle: FloatArray  # (M, 3) median position of every marker, m
    height: float  # height of the set of markers, m
    above: FloatArray  # (M,) height of every marker above the lowest one, as share of the height

    @classmethod
    def of(cls, labels: Sequence[str], points: FloatArray, rate: float) -> _Tracks:
        low, high = np.nanpercentile(points, [2, 98], axis=0)
        extent, middle = high - low, np.nanmedian(points, axis=0)
        height = float(high[:, 2].max() - low[:, 2].min())
        way, across = np.linalg.norm(extent, axis=1), np.hypot(extent[:, 0], extent[:, 1])
        above = (middle[:, 2] - middle[:, 2].min()) / height
        return cls(labels, points, rate, extent, way, across, middle, height, above)


def _find_steps(tracks: _Tracks) -> RecognisedMovement | None:
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
        return RecognisedMovement("walking", text)
    stepping, upper = low & (tracks.across > _STEPS * tracks.height), tracks.above > _UPPER
    if stepping.sum() < 2 or not upper.any() or np.median(tracks.across[upper]) > _STEPS * tracks.height:
        return None
    plan = points[:, stepping, :2] - np.nanmean(points[:, stepping, :2], axis=0)
    forwards = np.linalg.svd(np.nan_to_num(plan).reshape(-1, 2), full_matrices=False)[2][0]
    if np.corrcoef(np.nan_to_num(plan @ forwards), rowvar=False).min() > _ALTERNATE:
        return None
    text = "the feet move forwards and backwards in turn under a trunk that stays, as on a treadmill"
    return RecognisedMovement("walking", text)


def _find_flight(tracks: _Tracks) -> RecognisedMovement | None:
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
            return RecognisedMovement("jumping", text)
    return None


def _find_one_body(tracks: _Tracks) -> RecognisedMovement | None:
    """Return one-body if the markers that move, at least three, keep all their distances beside markers that stand."""
    moving = tracks.way > _STILL * tracks.height
    if moving.sum() < 3 or (~moving).sum() < 2:
        return None
    some = tracks.points[:: max(1, len(tracks.points) // 200), moving]
    apart = np.linalg.norm(some[:, :, None] - some[:, None], axis=3)
    spread = np.subtract(*np.nanpercentile(apart, [95, 5], axis=0)) / 3.3
    if np.nanmax(spread) > _RIGID * tracks.height:
        return None
    return RecognisedMovement("one-body", f"the {int(moving.sum())} markers that move are one rigid body")


def _find_rise(tracks: _Tracks) -> RecognisedMovement | None:
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
    return RecognisedMovement(
        "sit-to-stand",
        f"{int(stands.sum())} markers near the ground stand, and the trunk goes up and down by {100 * rise:.0f} cm",
    )


def _recognise_arm(tracks: _Tracks) -> RecognisedMovement:
    """Return reach or curl if landmarks or joints of an arm move beside a thorax that stays, else unknown."""
    if any("wheel" in label.lower() for label in tracks.labels):
        return RecognisedMovement("unknown", "the markers name a wheel, and no protocol is for wheelchairs")
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
        return RecognisedMovement(
            "unknown",
            "no feet stand under a trunk that goes up and down, no feet step or leave the ground, and the names of the "
            f"markers are not those of a whole arm{f' (only {known})' if known else ''}",
        )
    ways = np.linalg.norm(np.subtract(*np.nanpercentile(tracks.points, [95, 5], axis=0)), axis=1)
    far, bends, stays = (float(np.median(ways[at])) if at else 0.0 for at in (wrist, elbow, thorax))
    text = f"the wrist moves by {100 * far:.0f} cm, elbow and thorax by {100 * bends:.0f} and {100 * stays:.0f} cm"
    if far < _REACHES_M or stays > _TRUNK_STAYS * far:
        return RecognisedMovement("unknown", f"an arm is named, but {text}")
    return RecognisedMovement("curl" if bends < _ELBOW_STAYS * far else "reach", text)
