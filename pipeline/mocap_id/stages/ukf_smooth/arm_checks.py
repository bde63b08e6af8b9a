"""Checks of the motion of an arm: what no arm does shows exchanged landmarks, a wrong side or a wrong vertical axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.anatomy.angles import ELBOW, JointAngles
from mocap_id.arrays import FloatArray
from mocap_id.verdict import Reason

_HYPEREXTENDED = 20.0  # degrees: elbows extend by up to 15° beyond straight
_MOSTLY = 0.98  # quantile of the flexion
_LEANING = 45.0  # degrees, of the thorax from the vertical
_TURNED = (-150.0, -40.0)  # degrees, mean pronation that no forearm has


def arm_doubts(angles: Sequence[JointAngles], thorax: FloatArray) -> tuple[Reason, ...]:
    """Return cautions about a motion that no arm has.

    Parameters
    ----------
    angles : sequence of JointAngles
    thorax : (F, 3) array
        Long axis of the thorax in the trial, y up; no rows if unknown.
    """
    found = [*_leaning(thorax), *_turned_forearm(angles)]
    doubts = backward_elbow(angles)
    if found:
        text = f"{'; '.join(found)}. The angles are wrong by as much"
        doubts += (Reason("motion-implausible", text, float(len(found)), 0.0),)
    return doubts


def _leaning(thorax: FloatArray) -> list[str]:
    up = thorax[np.isfinite(thorax[:, 1]), 1]
    leaning = float(np.degrees(np.arccos(np.clip(np.median(up), -1.0, 1.0)))) if len(up) else 0.0
    if leaning <= _LEANING:
        return []
    return [
        f"the thorax leans {leaning:.0f}° from the vertical for most of the trial: unless the person lies, its "
        "landmarks are exchanged, or the vertical axis of the recording is wrong"
    ]


def _turned_forearm(angles: Sequence[JointAngles]) -> list[str]:
    pronation = next((each.angle[:, 2] for each in angles if each.names == ELBOW), np.zeros(0))
    pronation = pronation[np.isfinite(pronation)]
    mean = float(np.degrees(np.angle(np.mean(np.exp(1j * pronation))))) if len(pronation) else 0.0
    if not _TURNED[0] < mean < _TURNED[1]:
        return []
    return [f"the mean pronation is {mean:.0f}°, which no forearm has: RS and US are probably exchanged"]


def backward_elbow(angles: Sequence[JointAngles]) -> tuple[Reason, ...]:
    """Return a caution if the elbow bends backwards, as in a trial whose ``side`` is that of the other arm."""
    flexion = next((each.angle[:, 0] for each in angles if each.names == ELBOW), np.zeros(0))
    flexion = np.degrees(flexion[np.isfinite(flexion)])
    if not len(flexion):
        return ()
    low, high = np.quantile(flexion, [1 - _MOSTLY, _MOSTLY]).tolist()
    if low > -_HYPEREXTENDED or low + high > 0:
        return ()
    text = (
        f"the elbow bends backwards: its flexion is {low:.0f}° to {high:.0f}°. The arm is probably the other one: give "
        "the right `side:`, or check the names of the landmarks"
    )
    return (Reason("elbow-backwards", text, low, -_HYPEREXTENDED),)
