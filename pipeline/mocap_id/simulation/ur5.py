"""The thesis's robot (ch. 5): a UR5 on a bracket, stretched upwards, of which one joint swings.

Parameters are the reference rows of table 5.2 (Kufieta's model), distances the published ones of ch. 5.3.2, and the
motion is that of ch. 5.2: five periods of pi/4 at 0.25 or 0.5 Hz. Beyond the table, the mass of what moves comes from
the manufacturer's masses of the links, and the base, which stands still, may be anything that adds up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.simulation.body import Body, Link
from mocap_id.simulation.markers import PLACEMENT, PLATE, MarkerSet
from mocap_id.simulation.motion import Swing

JointName: TypeAlias = Literal["shoulder", "elbow", "wrist"]
Speed: TypeAlias = Literal["slow", "fast"]

TOTAL = 26.633  # kg
AMPLITUDE = np.pi / 4
FREQUENCY: Mapping[Speed, float] = {"slow": 0.25, "fast": 0.5}  # Hz
LEAD = 1.0  # s of rest before and after


@dataclass(frozen=True)
class Reference:
    """What moves beyond one joint: distance of the joint from the plate's centre (m), and m, my, Izz about it (SI)."""

    distance: float
    mass: float
    my: float
    inertia: float


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
"""Eighteen markers: label, across, height over the plate and depth, with the arm stretched upwards, m."""


def ur5(joint: JointName, speed: Speed) -> Body:
    """The robot with all joints but one locked."""
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
    told = {
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
    return Body((base, arm), (-0.2, 0.2), {"l1": known.distance}, told)


def swing(speed: Speed, periods: int) -> Swing:
    """The joint's motion about the stretched posture."""
    return Swing(FREQUENCY[speed], AMPLITUDE, 0.0, periods, LEAD)


def place(rng: np.random.Generator, joint: JointName) -> MarkerSet:
    """Eighteen markers on the robot and seven on the plate, none exactly where the plan has it."""
    distance = REFERENCE[joint].distance
    beyond = np.array([height > distance for _, _, height, _ in _SITES])
    local = np.array([(x, height - distance * (height > distance), z) for _, x, height, z in _SITES])
    local = np.concatenate([local, [(x, 0.004, z) for x, z in PLATE]])
    on_plate = np.arange(len(local)) >= len(_SITES)
    local += rng.normal(0, PLACEMENT, local.shape) * np.where(on_plate[:, None], (1.0, 0.1, 1.0), 1.0)
    link = np.concatenate([beyond, np.zeros(len(PLATE), dtype=np.bool_)]).astype(np.int64)
    return MarkerSet(
        labels=tuple(label for label, *_ in _SITES) + tuple(f"PLT{i + 1}" for i in range(len(PLATE))),
        link=link,
        local=local,
        softness=np.zeros(len(local)),
        hidden=link > 0,
        on_plate=on_plate,
        at_joint=(None,) * len(local),
    )
