"""Targets of reaches on the body, in the frame of the thorax, from tables of body proportions.

Heights are those of Drillis and Contini (1966), relative to the stature and to the sternal notch; the shoulders are
measured. The targets are good to a few centimetres, as no marker shows hip, mouth or head.
"""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.protocols.reach.arm_geometry import RecordedArm

_PLACES = {
    "hip": (-0.02, -0.29, 0.115),
    "mouth": (0.05, 0.085, 0.0),
    "head": (-0.02, 0.17, 0.0),
}
"""Forward, upward and to the right from the sternal notch, in statures."""
_SKIN = np.array([0.04, 0.015, 0.02])  # statures from the shoulder's centre to its surface in front, above and outside
OVERHEAD = 0.26
"""Height of an overhead shelf above the sternal notch, in statures: a hand's length above the head."""
LEVELS = {"waist": -0.21, "mouth": 0.085, "overhead": OVERHEAD}
"""Heights above the sternal notch, in statures."""
TOUCH = 0.05
"""Distance from the middle of a hand to a target that it touches, in statures: half of its width, and a margin."""


def body_targets(arm: RecordedArm) -> dict[str, FloatArray]:
    """Return the targets (3,) from the shoulder's centre in the axes of the thorax, m."""
    targets = {name: arm.stature * np.array(place) - arm.shoulder for name, place in _PLACES.items()}
    skin = arm.stature * _SKIN
    opposite = arm.shoulder * [1, 1, -1] - arm.shoulder
    return targets | {"same_shoulder": skin, "opposite_shoulder": opposite + skin * [1, 1, -1]}


def level_heights(arm: RecordedArm) -> dict[str, float]:
    """Return the heights of waist, mouth and overhead above the shoulder's centre, m."""
    return {name: float(height * arm.stature - arm.shoulder[1]) for name, height in LEVELS.items()}
