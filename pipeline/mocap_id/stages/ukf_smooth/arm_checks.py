"""Checks of an arm's motion, which find exchanged landmarks, a wrong side or a wrong vertical axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.anatomy.angles import ELBOW, JointAngles
from mocap_id.arrays import FloatArray
from mocap_id.verdict import Reason

_HYPEREXTENDED = 20.0  # degrees: elbows extend by up to 15° beyond straight
_MOSTLY = 0.98  # quantile of the flexion
_LEANING = 45.0  # degrees, of the thorax from the vertical
_ROTATED = (-150.0, -40.0)  # degrees, mean pronation that no forearm has


def check_arm_motion(angles: Sequence[JointAngles], thorax: FloatArray) -> tuple[Reason, ...]:
    """Return cautions if the motion is impossible for an arm; none if it is possible.

    ``angles`` are the angles of all joints. ``thorax`` (F, 3) is the long axis of the thorax in the trial's axes, y up;
    it has no rows if it is unknown.
    """
    elbow = next((each.angle for each in angles if each.names == ELBOW), np.zeros((0, 3)))
    texts = [*_check_thorax(thorax), *_check_pronation(elbow[:, 2])]
    reasons = _check_flexion(elbow[:, 0])
    if texts:
        message = f"{'; '.join(texts)}. The joint angles have errors of a similar size"
        reasons += (Reason("motion-implausible", message, float(len(texts)), 0.0),)
    return reasons


def _check_thorax(thorax: FloatArray) -> list[str]:
    up = thorax[np.isfinite(thorax[:, 1]), 1]
    lean = float(np.degrees(np.arccos(np.clip(np.median(up), -1.0, 1.0)))) if len(up) else 0.0
    if lean <= _LEANING:
        return []
    return [
        f"the thorax leans {lean:.0f}° from the vertical for most of the trial: unless the person lies down, its "
        "landmarks are exchanged, or the vertical axis of the recording is wrong"
    ]


def _check_pronation(pronation: FloatArray) -> list[str]:
    known = pronation[np.isfinite(pronation)]
    mean = float(np.degrees(np.angle(np.mean(np.exp(1j * known))))) if len(known) else 0.0
    if not _ROTATED[0] < mean < _ROTATED[1]:
        return []
    return [f"the mean pronation is {mean:.0f}°, which no forearm has: RS and US are probably exchanged"]


def _check_flexion(flexion: FloatArray) -> tuple[Reason, ...]:
    """Return a caution if the elbow bends backwards, as it does if ``side`` is wrong."""
    known = np.degrees(flexion[np.isfinite(flexion)])
    if not len(known):
        return ()
    low, high = np.quantile(known, [1 - _MOSTLY, _MOSTLY]).tolist()
    if low > -_HYPEREXTENDED or low + high > 0:
        return ()
    message = (
        f"the elbow bends backwards: its flexion is {low:.0f}° to {high:.0f}°. Probably the recording is of the other "
        "arm: correct `side:`, or check the names of the landmarks"
    )
    return (Reason("elbow-backwards", message, low, -_HYPEREXTENDED),)
