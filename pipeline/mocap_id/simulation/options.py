"""What one may choose about a simulated trial."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from mocap_id.errors import ConfigError
from mocap_id.simulation.people import People
from mocap_id.simulation.plate import Sense
from mocap_id.simulation.schedule import MANNERS, Strategy
from mocap_id.simulation.subject import Subject
from mocap_id.simulation.ur5 import FREQUENCY, REFERENCE, JointName, Speed

Kind: TypeAlias = Literal["sit-to-stand", "robot"]


@dataclass(frozen=True)
class Options:
    """Everything that is not drawn from the seed; the same options give the same files.

    Parameters
    ----------
    seed : int
        Of the body, its motion, the plane's direction and every error.
    repetitions : int
        Sit-to-stands, or periods of the robot's swing.
    strategy : {"normal", "dynamic", "stable"}
        How the person rises; the robot ignores it.
    rate, analog_rate : float
        Frames and analog samples a second, Hz; the second an integer multiple of the first.
    marker_noise : float
        Standard deviation a coordinate, m.
    soft_tissue : float
        Multiplies the skin's motion (0 = markers fixed to the bones).
    occlusions : float
        Multiplies how often markers vanish in bursts (0 = never).
    jumps : int
        How often some marker is mistaken for a reflection 20 to 80 mm away, for 5 to 100 frames.
    plate_sense : {"reaction", "action"}
        Whose force the channels hold: the plate's on the body, or the body's on the plate.
    plate_moved : bool
        Shifted, lifted and turned against the laboratory.
    plate_origin_flipped : bool
        The file holds ORIGIN with the wrong sign.
    plate_noise, plate_bias : float
        Multiply the usual noise (1 N, 0.3 N·m) and channel bias (3 N, 0.3 N·m).
    seat_plate : bool
        The chair stands on a plate of its own, the second one.
    chair_mass : float
        kg; that plate reads its weight too.
    attempts : int
        Rises that are broken off, one before each of the last repetitions.
    hold : float
        The last rise stops half-way for so long, s.
    rail : float
        Share of the vertical load that a hand on a rail carries while the person rises.
    clock_offset : float
        Analog sample k is taken at marker-clock time k / analog_rate + this, s.
    joint : {"shoulder", "elbow", "wrist"} or None
        Of the thesis's UR5, for the robot; None draws a robot and its swing.
    speed : {"slow", "fast"}
        Of that joint: 0.25 or 0.5 Hz.
    orientation : float
        Yaw of the UR5's plane, degrees.
    people : People
        What the person has that four rigid segments on pins have not; the robot ignores it.
    subject : Subject or None
        Whose sit-to-stands these are; the seed is then of the motion, of where the feet stand and of the errors alone.

    Raises
    ------
    ConfigError
        A value is out of range.
    """

    seed: int = 0
    repetitions: int = 5
    strategy: Strategy = "normal"
    rate: float = 100.0
    analog_rate: float = 1000.0
    marker_noise: float = 0.0005
    soft_tissue: float = 1.0
    occlusions: float = 1.0
    jumps: int = 0
    plate_sense: Sense = "reaction"
    plate_moved: bool = False
    plate_origin_flipped: bool = False
    plate_noise: float = 1.0
    plate_bias: float = 0.0
    clock_offset: float = 0.0
    seat_plate: bool = False
    chair_mass: float = 6.0
    subject: Subject | None = None
    attempts: int = 0
    hold: float = 0.0
    rail: float = 0.0
    joint: JointName | None = None
    speed: Speed = "fast"
    orientation: float = 0.0
    people: People = field(default_factory=People)

    def __post_init__(self) -> None:
        multiple = self.analog_rate / self.rate if self.rate > 0 else 0.0
        checks = (
            ("seed", self.seed, self.seed >= 0, "a whole number, 0 or more"),
            ("repetitions", self.repetitions, 1 <= self.repetitions <= 50, "1 … 50"),
            ("strategy", self.strategy, self.strategy in MANNERS, "one of " + ", ".join(MANNERS)),
            ("rate", self.rate, 20 <= self.rate <= 2000, "20 … 2000 Hz"),
            ("analog_rate", self.analog_rate, multiple >= 1 and multiple % 1 == 0, "a multiple of rate"),
            ("marker_noise", self.marker_noise, 0 <= self.marker_noise <= 0.05, "0 … 0.05 m"),
            ("soft_tissue", self.soft_tissue, 0 <= self.soft_tissue <= 10, "0 … 10"),
            ("occlusions", self.occlusions, 0 <= self.occlusions <= 10, "0 … 10"),
            ("jumps", self.jumps, 0 <= self.jumps <= 10_000, "a whole number, 0 … 10000"),
            ("plate_sense", self.plate_sense, self.plate_sense in ("reaction", "action"), "reaction or action"),
            ("plate_noise", self.plate_noise, 0 <= self.plate_noise <= 100, "0 … 100"),
            ("plate_bias", self.plate_bias, 0 <= self.plate_bias <= 100, "0 … 100"),
            ("chair_mass", self.chair_mass, 0 <= self.chair_mass <= 50, "0 … 50 kg"),
            ("attempts", self.attempts, 0 <= self.attempts <= self.repetitions, "0 … repetitions"),
            ("hold", self.hold, 0 <= self.hold <= 10, "0 … 10 s"),
            ("rail", self.rail, 0 <= self.rail <= 0.5, "0 … 0.5"),
            ("joint", self.joint, self.joint is None or self.joint in REFERENCE, "one of " + ", ".join(REFERENCE)),
            ("speed", self.speed, self.speed in FREQUENCY, "one of " + ", ".join(FREQUENCY)),
            ("orientation", self.orientation, abs(self.orientation) <= 180, "-180 … 180 degrees"),
            ("clock_offset", self.clock_offset, abs(self.clock_offset) <= 1, "-1 … 1 s"),
        )
        for name, value, fine, expected in checks:
            if not fine:
                raise ConfigError(f"simulate: {name} is {value!r}; expected {expected}")
