"""Reaches in a recording: times, target, and the distance by which the hand missed the target.

The targets on the body and the heights come from tables of body proportions (Drillis and Contini 1966), relative to the
sternal notch; the shoulders are measured. The targets have errors of a few centimetres, because no marker is on hip,
mouth or head.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.protocols.reach.workspace import RecordedArm

_MOVING = 0.12  # share of the 98 % quantile of the speed; below it, the hand rests
_SLOWEST = 0.04  # m/s, lowest threshold of the speed
_PAUSE = 0.08  # s, shortest pause between two movements
_LEAST = 0.25  # s, shortest movement
_FAR = 0.12  # share of the arm's length: a movement that ends nearer to its start is ignored
_HOME = 0.25  # share of the arm's length: radius of the region where the hand rests
_ANY = 0.17  # statures: a hand farther from every target did not go to a target
# position of each target relative to the sternal notch, in statures: forward, upward and to the right
_PLACES = {
    "hip": (-0.02, -0.29, 0.115),
    "mouth": (0.05, 0.085, 0.0),
    "head": (-0.02, 0.17, 0.0),
}
_SKIN = np.array([0.04, 0.015, 0.02])  # statures from the shoulder's centre to its surface in front, above and outside
# height above the sternal notch, in statures; an overhead shelf is a hand's length above the head
_LEVELS = {"waist": -0.21, "mouth": 0.085, "overhead": 0.26}
_ENDS = "the recording ends before the hand leaves the target"
# distance from the middle of a hand to a target that it touches, in statures: half a hand's width and a margin
_TOUCH = 0.05


@dataclass(frozen=True)
class Reach:
    """Movement of the hand from its rest position or another target to a target, with the stay at this target."""

    # start, top, end: times at which the hand starts, is in the middle of its stay at the target, and is back at rest
    # or leaves for another target, s
    start: float
    top: float
    end: float
    # target: ``hip``, ``same_shoulder``, ``opposite_shoulder``, ``mouth``, ``head``, ``overhead`` or ``none``
    target: str
    miss: float  # distance by which the hand missed the target, m; 0 if it touched the target, NaN without a target
    complete: bool  # whether the hand came back or moved to another target
    why: str  # reason why it is not complete, or why an event or the target is unknown; otherwise empty


def find_reaches(time: FloatArray, arm: RecordedArm) -> tuple[Reach, ...]:
    """Find the reaches in a recording from the path of the palm; the sample times ``time`` (T,), s, are equidistant."""
    palms = arm.palms
    known = np.isfinite(palms).all(axis=1)
    measured = arm.measured & known
    if known.sum() < 10:
        return ()
    path = np.stack([np.interp(time, time[known], each) for each in palms[known].T], axis=1)
    # first and last sample of every movement of the hand between two pauses
    speed = np.linalg.norm(np.gradient(path, time, axis=0), axis=1)
    threshold = max(_MOVING * float(np.quantile(speed, 0.98)), _SLOWEST)
    rate = 1 / float(np.median(np.diff(time)))
    moving = speed > threshold
    for a, b in _find_spans(~moving):
        if b - a < round(_PAUSE * rate):
            moving[a:b] = True
    least = _FAR * arm.arm.length
    moves = [
        (a, b)
        for a, b in _find_spans(moving)
        if (b - a) / rate >= _LEAST and np.linalg.norm(path[b] - path[a]) >= least
    ]
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
        target, miss = _find_target(arm, slice(last, (follows[0] if follows else len(time) - 1) + 1), path)
        events = {name: float(time[at]) for name, at in (("start", first), ("top", top), ("end", stop))}
        why = [] if follows else [_ENDS]
        for name, at in zip(events, (first, top, stop), strict=True):
            hidden = np.flatnonzero(~measured[max(at - 1, 0) : at + 2])
            if len(hidden):
                events[name] = float("nan")
                why.append(f"the arm is not measured at its {name} ({time[at]:.2f} s)")
        reaches.append(Reach(**events, target=target, miss=miss, complete=follows is not None, why="; ".join(why)))
    return tuple(reaches)


def _find_spans(flags: BoolArray) -> list[tuple[int, int]]:
    """Return the first sample of each run of True, and the sample after it, or the last one if the run ends there."""
    return [(run.start, min(run.stop, len(flags) - 1)) for run in find_runs(flags)]


def _find_target(arm: RecordedArm, held: slice, path: FloatArray) -> tuple[str, float]:
    """Return the target nearest to the hand in the samples ``held``, and by how much the hand misses it, m.

    The second value is 0 if the hand touches the target. Without a near target, the result is "none" and NaN.
    """
    seen = arm.measured[held] & np.isfinite(arm.wrists[held]).all(axis=1)
    if not seen.any():
        return "none", float("nan")
    palm, wrist = (np.median(each[held][seen], axis=0) for each in (path, arm.wrists))
    fingers = 2 * palm - wrist
    along, far = fingers - wrist, {}
    for name, place in locate_body_targets(arm).items():  # distance from the line between wrist and fingers
        share = np.clip((place - wrist) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        far[name] = float(np.linalg.norm(wrist + share * along - place))
    overhead = compute_level_heights(arm)["overhead"]
    if fingers[1] >= overhead and min(far.values()) > _TOUCH * arm.stature:
        return "overhead", 0.0
    name = min(far, key=lambda each: far[each])
    if far[name] > _ANY * arm.stature:
        return "none", float("nan")
    return name, max(far[name] - _TOUCH * arm.stature, 0.0)


def locate_body_targets(arm: RecordedArm) -> dict[str, FloatArray]:
    """Return the positions (3,) of the targets from the shoulder's centre, in the axes of the thorax, m, by name."""
    targets = {name: arm.stature * np.array(place) - arm.shoulder for name, place in _PLACES.items()}
    skin = arm.stature * _SKIN
    opposite = arm.shoulder * [1, 1, -1] - arm.shoulder
    return targets | {"same_shoulder": skin, "opposite_shoulder": opposite + skin * [1, 1, -1]}


def compute_level_heights(arm: RecordedArm) -> dict[str, float]:
    """Return the heights of the levels waist, mouth and overhead above the shoulder's centre, m, by name."""
    return {name: float(height * arm.stature - arm.shoulder[1]) for name, height in _LEVELS.items()}
