"""Reaches in a motion: times, target, and the distance by which the hand missed the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.protocols.reach.arm_geometry import RecordedArm
from mocap_id.protocols.reach.body_targets import TOUCH, body_targets, level_heights

_MOVING = 0.12  # share of the 98 % quantile of the speed from which the hand moves
_SLOWEST = 0.04  # m/s, least threshold
_PAUSE = 0.08  # s, least pause between two movements
_LEAST = 0.25  # s, least movement
_FAR = 0.12  # of the arm's length: a movement that ends nearer to its start does not count
_HOME = 0.25  # of the arm's length around the place where the hand rests
_ANY = 0.17  # statures; a hand farther from every target went to none of them


@dataclass(frozen=True)
class Reach:
    """One reach.

    Parameters
    ----------
    start, top, end : float
        Times at which the hand leaves, is held (middle of the time), and leaves the target or is back, s.
    target : str
        ``hip``, ``same_shoulder``, ``opposite_shoulder``, ``mouth``, ``head``, ``overhead`` or ``none``.
    miss : float
        Distance by which the target was missed, m; 0 if it was touched, NaN without a target.
    complete : bool
        The hand came back or went on to another target.
    """

    start: float
    top: float
    end: float
    target: str
    miss: float
    complete: bool


def find_reaches(time: FloatArray, arm: RecordedArm) -> tuple[Reach, ...]:
    """Find the reaches of a motion from the path of the palm in the thorax.

    Parameters
    ----------
    time : (T,) array
        s, uniform.
    arm : RecordedArm
    """
    palms = arm.palms
    known = np.isfinite(palms).all(axis=1)
    if known.sum() < 10:
        return ()
    path = np.stack([np.interp(time, time[known], each) for each in palms[known].T], axis=1)
    moves = _movements(time, path, arm.arm.length)
    if not moves:
        return ()
    home = path[: moves[0][0] + 1].mean(axis=0)
    near = _HOME * arm.arm.length
    reaches = []
    for k, (first, last) in enumerate(moves):
        if np.linalg.norm(path[last] - home) < near:
            continue
        follows = moves[k + 1] if k + 1 < len(moves) else None
        back = follows is not None and np.linalg.norm(path[follows[1]] - home) < near
        top = (last + (follows[0] if follows else len(time) - 1)) // 2
        stop = len(time) - 1 if follows is None else follows[1] if back else follows[0]
        target, miss = _target(arm, slice(last, (follows[0] if follows else len(time) - 1) + 1), path)
        reaches.append(
            Reach(float(time[first]), float(time[top]), float(time[stop]), target, miss, complete=follows is not None)
        )
    return tuple(reaches)


def _movements(time: FloatArray, path: FloatArray, length: float) -> list[tuple[int, int]]:
    """Return first and last sample of every movement of the hand, between two pauses."""
    speed = np.linalg.norm(np.gradient(path, time, axis=0), axis=1)
    threshold = max(_MOVING * float(np.quantile(speed, 0.98)), _SLOWEST)
    rate = 1 / float(np.median(np.diff(time)))
    moving = _without_short(speed > threshold, round(_PAUSE * rate), value=False)
    spans = _spans(moving)
    return [(a, b) for a, b in spans if (b - a) / rate >= _LEAST and np.linalg.norm(path[b] - path[a]) >= _FAR * length]


def _spans(there: BoolArray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(np.int8)))
    return [(int(a), min(int(b), len(there) - 1)) for a, b in edges.reshape(-1, 2)]


def _without_short(there: BoolArray, least: int, *, value: bool) -> BoolArray:
    """Return the samples, with runs of ``value`` that are shorter than ``least`` set to its opposite."""
    found = there.copy()
    for a, b in _spans(there == value):
        if b - a < least:
            found[a:b] = not value
    return found


def _target(arm: RecordedArm, held: slice, path: FloatArray) -> tuple[str, float]:
    """Return the nearest part of the body and the distance by which the hand misses it, m."""
    palm, seen = np.median(path[held], axis=0), np.isfinite(arm.wrists[held]).all(axis=1)
    wrist = np.median(arm.wrists[held][seen], axis=0) if seen.any() else palm
    far = {name: _distance(place, wrist, 2 * palm - wrist) for name, place in body_targets(arm).items()}
    overhead = level_heights(arm)["overhead"]
    if 2 * palm[1] - wrist[1] >= overhead and min(far.values()) > TOUCH * arm.stature:
        return "overhead", 0.0
    name = min(far, key=lambda each: far[each])
    if far[name] > _ANY * arm.stature:
        return "none", float("nan")
    return name, max(far[name] - TOUCH * arm.stature, 0.0)


def _distance(point: FloatArray, start: FloatArray, end: FloatArray) -> float:
    """Return the distance of a point from the line between two points, m."""
    along = end - start
    share = np.clip((point - start) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(start + share * along - point))
