"""The thesis's robot (ch. 5): a UR5 on a bracket, stretched upwards, with one swinging joint.

The parameters come from the reference rows of table 5.2 (Kufieta's model), the distances from ch. 5.3.2. The motion is
that of ch. 5.2: five periods of amplitude pi/4 at 0.25 or 0.5 Hz. The moving mass, which the table does not list, is
the sum of the manufacturer's link masses. The fixed base has the remaining mass.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.simulation.body import Link, SimulatedBody
from mocap_id.simulation.joint_motion import Swing
from mocap_id.simulation.markers import MarkerSet, add_plate_markers

JointName: TypeAlias = Literal["shoulder", "elbow", "wrist"]
Speed: TypeAlias = Literal["slow", "fast"]

TOTAL = 26.633  # kg
AMPLITUDE = np.pi / 4
FREQUENCY: Mapping[Speed, float] = {"slow": 0.25, "fast": 0.5}  # Hz
LEAD = 1.0  # s of rest before and after the motion


@dataclass(frozen=True)
class Reference:
    """Moving part of the robot, distal to a joint."""

    distance: float  # distance of the joint from the plate's centre, m
    mass: float  # kg
    my: float  # first moment about the joint, kg·m
    inertia: float  # moment of inertia about the joint, kg·m²


REFERENCE: Mapping[JointName, Reference] = {
    "shoulder": Reference(0.101, 13.2939, 5.540, 3.760),
    "elbow": Reference(0.526, 4.9009, 1.760, 0.700),
    "wrist": Reference(0.918, 2.6259, 0.110, 0.010),
}

_SITES = (
    ("BAS1", 0.060, 0.045, 0.065),
    ("BAS2", -0.055, 0.060, 0.070),
    ("BAS3", 0.005, 0.080, -0.080),
    ("UPA1", 0.050, 0.165, 0.110),
    ("UPA2", -0.050, 0.225, 0.120),
    ("UPA3", 0.048, 0.290, 0.095),
    ("UPA4", -0.046, 0.355, 0.115),
    ("UPA5", 0.044, 0.420, 0.125),
    ("UPA6", -0.052, 0.480, 0.105),
    ("FOA1", 0.045, 0.580, 0.050),
    ("FOA2", -0.040, 0.650, 0.060),
    ("FOA3", 0.038, 0.720, 0.020),
    ("FOA4", -0.042, 0.790, 0.065),
    ("FOA5", 0.036, 0.860, 0.035),
    ("WRI1", 0.050, 0.955, 0.045),
    ("WRI2", -0.048, 0.985, 0.055),
    ("WRI3", 0.040, 1.015, 0.025),
    ("WRI4", -0.034, 1.040, 0.070),
)
"""Eighteen markers: label, x, height above the plate and depth, m, while the arm is stretched upwards."""


def ur5_body(joint: JointName, speed: Speed) -> SimulatedBody:
    """Return the robot with all joints locked except one."""
    known = REFERENCE[joint]
    com = known.my / known.mass
    base = Link("base", None, (0, 0), known.distance, TOTAL - known.mass, (0.0, known.distance / 2), 0.1)
    arm = Link(
        "link",
        joint,
        (0.0, known.distance),
        _SITES[-1][2] - known.distance,
        known.mass,
        (0.0, com),
        known.inertia - known.my * com,
    )
    description = {
        "joint": joint,
        "speed": speed,
        "table_5_2_reference": {
            "m1_plus_m2": TOTAL,
            "mx1_Txm2": 0.0,
            "mx2": 0.0,
            "my2": known.my,
            "Izz2": known.inertia,
        },
    }
    return SimulatedBody((base, arm), (-0.2, 0.2), {"l1": known.distance}, description)


def make_swing(speed: Speed, periods: int) -> Swing:
    """Return the motion of the joint about the stretched posture."""
    return Swing(FREQUENCY[speed], AMPLITUDE, 0.0, periods, LEAD)


def place_markers(rng: np.random.Generator, joint: JointName) -> MarkerSet:
    """Place eighteen markers on the robot and seven on the plate, with random placement errors."""
    distance, count = REFERENCE[joint].distance, len(_SITES)
    link = np.array([height > distance for _, _, height, _ in _SITES]).astype(np.int64)
    local = np.array([(x, height - distance * (height > distance), z) for _, x, height, z in _SITES])
    labels = tuple(label for label, *_ in _SITES)
    softness = np.zeros(count)
    return add_plate_markers(rng, labels, link, local, softness=softness, hidden=link > 0, at_joint=(None,) * count)
