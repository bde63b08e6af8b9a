"""Options of simulated trials: one field each, with its default, limits and help text.

The command line and its documentation are generated from these fields.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, TypeAlias, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from mocap_id.errors import ConfigError

Kind: TypeAlias = Literal["sit-to-stand", "robot"]
Strategy: TypeAlias = Literal["normal", "dynamic", "stable"]
Sense: TypeAlias = Literal["reaction", "action"]
MarkerSetName: TypeAlias = Literal["clusters", "plug-in-gait", "plug-in-gait-without-wands", "joints"]
JointName: TypeAlias = Literal["shoulder", "elbow", "wrist"]
Speed: TypeAlias = Literal["slow", "fast"]
LARGEST = float("inf")


def option(default: Any, help_text: str, limits: tuple[float, float] | None = None, unit: str = "") -> Any:
    """Return a dataclass field with a help text, and with limits that :func:`check_options` checks."""
    return field(default=default, metadata={"help": help_text, "limits": limits, "unit": unit})


def check_options(options: Any, command: str) -> None:
    """Raise ConfigError if an option is outside its limits, or not among the values of its literal type."""
    model: Any = type(options)
    for each in fields(options):
        value, limits = getattr(options, each.name), each.metadata.get("limits")
        if limits is not None and value is not None and not limits[0] <= value <= limits[1]:
            upper = " or more" if limits[1] == LARGEST else f" … {limits[1]:g}"
            _refuse(command, each.name, value, f"{limits[0]:g}{upper} {each.metadata['unit']}".rstrip())
        choices = _find_choices(model).get(each.name)
        if choices is not None and value not in choices:
            _refuse(command, each.name, value, "one of " + ", ".join(filter(None, choices)))


@cache
def _find_choices(model: type) -> Mapping[str, tuple[str | None, ...]]:
    """Return the values of every option with a literal type, by its name; None if the option may be omitted."""
    found: dict[str, tuple[str | None, ...]] = {}
    for name, kind in get_type_hints(model).items():
        parts = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
        for literal in (part for part in parts if get_origin(part) is Literal):
            found[name] = (*get_args(literal), *((None,) if NoneType in parts else ()))
    return found


def _refuse(command: str, name: str, value: object, expected: str) -> None:
    raise ConfigError(f"{command}: `{name}` is {value!r}; expected {expected}")


@dataclass(frozen=True)
class PersonOptions:
    """Differences between a simulated person and a chain of four rigid segments (the pinned chain); none by default.

    A range is approximate: the seed makes some repetitions larger than others. A value out of range raises ConfigError.
    """

    hip_gap_mm: float = option(
        0.0,
        "Range of the pelvis's displacement from the thigh's hip centre, mm; 6 to 16 in real people.",
        (0, 40),
        "mm",
    )
    lumbar_deg: float = option(
        0.0,
        "Range of the trunk's rotation relative to the pelvis, degrees; 10 to 20 in people.",
        (0, 40),
        "degrees",
    )
    arm_swing_deg: float = option(0.0, "Range of the arms' swing about the shoulders, degrees.", (0, 120), "degrees")
    heel_lift_mm: float = option(
        0.0, "Height of the heel while the person rises and the foot rotates about the toes, mm.", (0, 60), "mm"
    )
    held_mass_kg: float = option(0.0, "Mass of a weight in the hands, in addition to the person's, kg.", (0, 20), "kg")

    def __post_init__(self) -> None:
        check_options(self, "simulate: `people`")

    @property
    def differs_from_chain(self) -> bool:
        """Whether the person differs from the pinned chain."""
        return self != PersonOptions()


@dataclass(frozen=True)
class FaultOptions:
    """Faults of a recording; none by default. The seed decides which marker has a fault, when and where.

    A value out of range raises ConfigError.
    """

    frozen_s: float = option(0.0, "Time for which a moving marker keeps its last position, s.", (0, 60), "s")
    ghost_walks: float = option(0.0, "1 adds a moving trajectory that belongs to no marker.", (0, 1))
    ghost_reflects: float = option(0.0, "1 adds the mirror image of a marker.", (0, 1))
    reattached_mm: float = option(
        0.0, "Distance between a moving marker's positions before and after it falls off, mm.", (0, 200), "mm"
    )
    mislabelled_s: float = option(0.0, "Time for which two moving markers exchange their names, s.", (0, 60), "s")
    wander_mm: float = option(0.0, "Slow drift (below 0.5 Hz) of every marker, mm rms.", (0, 10), "mm")
    wobble_mm: float = option(
        0.0, "Oscillation at 4 Hz of the skin of each segment, equal for all its markers, mm rms.", (0, 10), "mm"
    )
    filter_hz: float = option(0.0, "Cut-off frequency of a zero-phase low-pass filter, Hz.", (0, 50), "Hz")
    repeated_share: float = option(0.0, "Fraction of the frames that repeat the previous one.", (0, 0.9))
    camera_scale: float = option(0.0, "Relative error of all distances between markers.", (-0.2, 0.2))
    tilt_deg: float = option(
        0.0, "Tilt of the cameras' coordinate frame in the plane of motion, degrees.", (-10, 10), "degrees"
    )
    rate_error: float = option(0.0, "Relative error of the frame rate and the analog rate in the file.", (-0.5, 0.5))
    gain: float = option(0.0, "Relative error of all channels of the plate.", (-0.9, 1))
    gain_fz: float = option(0.0, "Relative error of the plate's vertical force.", (-0.9, 1))
    gain_moments: float = option(0.0, "Relative error of the plate's moments.", (-0.9, 1))
    offset_fz_N: float = option(0.0, "Constant error of the vertical force, N.", (-200, 200), "N")  # noqa: N815  a unit
    corners_mm: float = option(0.0, "Error of the plate's corners in the file along the motion, mm.", (0, 200), "mm")
    foot_slide_mm: float = option(0.0, "Distance by which the feet slide once, while seated, mm.", (0, 100), "mm")
    foot_moves_mm: float = option(
        0.0, "Largest distance of the feet from their first position in the later repetitions, mm.", (0, 100), "mm"
    )
    turn_deg: float = option(
        0.0, "Angle by which the seated person rotates about the vertical at mid-trial, degrees.", (0, 45), "degrees"
    )
    plane_tilt_deg: float = option(0.0, "Sideways lean of the plane of motion, degrees.", (-20, 20), "degrees")

    def __post_init__(self) -> None:
        check_options(self, "simulate: `faults`")

    @property
    def present(self) -> dict[str, float]:
        """Faults that are not zero."""
        return {name: value for name, value in vars(self).items() if value}


Sex: TypeAlias = Literal["female", "male"]
_SEXES: tuple[Sex, ...] = ("female", "male")
_HEIGHT = {"female": (1.52, 1.76), "male": (1.64, 1.92)}  # m
_BODY_MASS_INDEX = (19.0, 29.0)  # kg/m²


@dataclass(frozen=True)
class SimulatedSubject:
    """A person who performs several trials with the same body, markers and skin."""

    name: str
    seed: int  # seed of the body's proportions, the markers' positions and the sliding of the skin
    sex: Sex
    height: float  # m
    mass: float  # kg


def draw_subject(seed: int, number: int) -> SimulatedSubject:
    """Draw person ``number`` of a cohort, counted from 1; odd numbers are female. The cohort's size has no effect."""
    source = np.random.SeedSequence([seed, number])
    rng = np.random.default_rng(source)
    sex = _SEXES[(number - 1) % len(_SEXES)]
    height = float(rng.uniform(*_HEIGHT[sex]))
    mass = float(rng.uniform(*_BODY_MASS_INDEX)) * height**2
    return SimulatedSubject(f"s{number:02d}", int(source.generate_state(2)[1]), sex, height, mass)


@dataclass(frozen=True)
class Options:
    """Options of a simulated trial; the same options give the same files.

    A robot ignores the options of a person, and a person ignores the options of a robot. ``subject`` fixes the person:
    the seed then determines only the motion, the position of the feet and the errors. A value out of range raises
    ConfigError.
    """

    seed: int = option(0, "Seed of the body, its motion, the direction of the plane and every error.", (0, LARGEST))
    repetitions: int = option(5, "Number of sit-to-stands, or of the robot's swings.", (1, 50))
    strategy: Strategy = option("normal", "How the person rises.")
    rate: float = option(100.0, "Frame rate, Hz.", (20, 2000), "Hz")
    analog_rate: float = option(1000.0, "Analog sampling rate, Hz; a multiple of the frame rate.")
    marker_noise: float = option(0.0005, "Standard deviation of each marker coordinate, m.", (0, 0.05), "m")
    soft_tissue: float = option(1.0, "Factor on the motion of the skin; 0 fixes the markers to the bones.", (0, 10))
    occlusions: float = option(1.0, "Factor on how often markers are occluded; 0 for never.", (0, 10))
    jumps: int = option(
        0,
        "Number of jumps: a marker is measured 20 to 80 mm from its position for 5 to 100 frames.",
        (0, 10000),
    )
    plate_sense: Sense = option(
        "reaction", "Measured force: of the plate on the body (reaction) or of the body on the plate (action)."
    )
    plate_moved: bool = option(False, "Shift, lift and rotate the plate in the laboratory.")
    plate_origin_flipped: bool = option(False, "Write the plate's ORIGIN with the wrong sign.")
    plate_noise: float = option(1.0, "Factor on the usual noise (1 N, 0.3 N·m).", (0, 100))
    plate_bias: float = option(0.0, "Factor on the usual channel bias (3 N, 0.3 N·m).", (0, 100))
    clock_offset: float = option(
        0.0, "Time on the markers' clock at which the first analog sample is taken, s.", (-1, 1), "s"
    )
    board: bool = option(False, "Replace the plate by a balance board with its own clock; for a person only.")
    imus: bool = option(False, "Add an inertial sensor with its own clock to every moving segment; for a person only.")
    seat_plate: bool = option(False, "Put the chair on a second plate.")
    chair_mass: float = option(6.0, "Mass of the chair on that plate, kg.", (0, 50), "kg")
    attempts: int = option(0, "Number of failed rises; each precedes one of the last repetitions.")
    hold: float = option(0.0, "Duration of a stop half-way through the last rise, s.", (0, 10), "s")
    rail: float = option(0.0, "Fraction of the vertical force on a rail that the person holds while rising.", (0, 0.5))
    people: PersonOptions = field(default_factory=PersonOptions)
    rest_before: float = option(0.0, "Rest before the first rise, s.", (0, 600), "s")
    rest_standing: float = option(0.0, "Additional rest in the first standing phase, s.", (0, 600), "s")
    rest_after: float = option(0.0, "Rest after the last repetition, s.", (0, 600), "s")
    marker_set: MarkerSetName = option(
        "clusters",
        "Markers of the person: clusters on every segment and on the plate, Plug-in-Gait, or one at each joint.",
    )
    without: str = option("", "Markers to leave out, separated by commas, such as `KNE`, `LKNE` or `R*`.")
    knee_on_shank: bool = option(False, "Fix the knee marker of Plug-in-Gait to the shank instead of the thigh.")
    faults: FaultOptions = field(default_factory=FaultOptions)
    joint: JointName | None = option(None, "Moving joint of the thesis's UR5 robot; a random robot if omitted.")
    speed: Speed = option("fast", "Speed of that joint: 0.25 or 0.5 Hz.")
    orientation: float = option(0.0, "Yaw of the plane of that robot, degrees.", (-180, 180), "degrees")
    joint_sensor: bool = option(False, "Add a wrench sensor in the robot's joint (sensor.csv).")
    subject: SimulatedSubject | None = None

    def __post_init__(self) -> None:
        check_options(self, "simulate")
        multiple = self.analog_rate / self.rate
        if not (multiple >= 1 and multiple % 1 == 0):
            _refuse("simulate", "analog_rate", self.analog_rate, "a multiple of `rate`")
        if self.board and (self.seat_plate or self.joint is not None):
            _refuse("simulate", "board", self.board, "False together with `seat_plate` or `joint`")
        if self.imus and (self.joint is not None or self.people.differs_from_chain):
            _refuse("simulate", "imus", self.imus, "False together with `joint` or `people`")
        if not 0 <= self.attempts <= self.repetitions:
            _refuse("simulate", "attempts", self.attempts, f"0 … {self.repetitions}, the number of `repetitions`")


_Numbers = TypeVar("_Numbers", PersonOptions, FaultOptions)


def read_people(text: str) -> PersonOptions:
    """Read a person's options from text like ``hip_gap_mm=10,held_mass_kg=2``; errors as for :func:`read_faults`."""
    return _read_numbers(text, "people", PersonOptions)


def read_faults(text: str) -> FaultOptions:
    """Read faults from text like ``frozen_s=4,gain_fz=0.05``.

    ConfigError is raised if an entry is not ``name=number``, a name is repeated, or a value is out of range.
    """
    return _read_numbers(text, "faults", FaultOptions)


def _read_numbers(text: str, option: str, model: type[_Numbers]) -> _Numbers:
    names = [each.name for each in fields(model)]
    values: dict[str, float] = {}
    for pair in filter(None, (part.strip() for part in text.split(","))):
        name, _, number = (part.strip() for part in pair.partition("="))
        if name not in names or name in values:
            raise ConfigError(
                f"simulate: `{option}`: {pair!r} is unknown or repeated; expected each of these names at most once: "
                f"{', '.join(names)}"
            )
        try:
            values[name] = float(number)
        except ValueError:
            _refuse(f"simulate: `{option}`", name, number, "a number")
    return model(**values)


Preset: TypeAlias = Literal["clean", "default", "hard"]
Movement: TypeAlias = Literal["reach", "curl"]
Side: TypeAlias = Literal["right", "left"]
CurlCondition: TypeAlias = Literal["C", "AC", "2", "3", "4", "5"]
"""Conditions of thesis figure 8.5: without the device, with open chambers, and the modes of the device."""
KINDS = "SHT"
"""Letters of joint kinds: ball (spherical), hinge, two-axis."""


@dataclass(frozen=True)
class Difficulty:
    """Sizes of the errors of a preset."""

    marker_noise: float  # standard deviation of each marker coordinate, m
    soft_tissue: float  # factor on the sliding of the skin
    twist_loss: float  # factor on the fraction of the axial rotation that the skin does not follow
    palpation: float  # standard deviation of each coordinate of a landmark's marker on its bone, m
    occlusions: float  # factor on how often markers are occluded
    tremor: float  # factor on the irregularity of the motion


PRESETS: Mapping[Preset, Difficulty] = {
    "clean": Difficulty(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    "default": Difficulty(0.0005, 1.0, 1.0, 0.003, 1.0, 1.0),
    "hard": Difficulty(0.0008, 2.0, 1.5, 0.006, 2.0, 1.0),
}


@dataclass(frozen=True)
class ArmOptions:
    """Options of a simulated arm; the same options give the same files.

    ``subject`` fixes the person, the markers and the skin: the seed then determines only the motion and the noise.
    A different seed ``markers`` places the markers again, as in a new session. A value out of range raises ConfigError.
    """

    seed: int = option(0, "Seed of the person, the motion and every error.", (0, LARGEST))
    subject: int | None = option(None, "Seed of the person and the markers; by default the trial's seed.", (0, LARGEST))
    markers: int | None = option(None, "Seed of the markers and the skin; by default the person's seed.", (0, LARGEST))
    preset: Preset = option("default", "Size of noise, soft tissue, palpation error and occlusions.")
    movement: Movement = option("reach", "Functional reaches, or curls on a bench.")
    side: Side = option("right", "Arm that carries the markers.")
    severity: float = option(0.3, "Limitation of the reaches: 0 healthy, 1 almost no reach.", (0, 1))
    cycles: int = option(2, "Number of rounds of all reaches.", (1, 20))
    repetitions: int = option(8, "Number of curls.", (1, 100))
    failed: int = option(0, "Number of failed curls at the end.", (0, 20))
    compensation: float = option(0.25, "Size of the compensating shoulder motion in tired curls.", (0, 2))
    condition: CurlCondition = option(
        "C", "Curls without the pneumatic device (C), with open chambers (AC), or in one of its modes."
    )
    calibration: str = option("", "YAML file of a calibration trial of the same person, relative to the new folder.")
    glide_mm: float = option(15.0, "Shift of the shoulder at 180° of elevation in reaches, mm.", (0, 40), "mm")
    rate: float = option(120.0, "Frame rate, Hz.", (20, 2000), "Hz")
    soft_tissue: float = option(1.0, "Factor on the preset's soft tissue; 0 fixes the markers to the bones.", (0, 10))
    anonymous: bool = option(False, "Name the markers of the clusters M000, M001, ….")
    imus: bool = option(False, "Add an inertial sensor with its own clock to every segment.")
    skeleton: bool = option(False, "Add kinect.csv, the skeleton of a depth camera.")

    def __post_init__(self) -> None:
        check_options(self, "simulate arm")


@dataclass(frozen=True)
class ChainOptions:
    """Options of a simulated chain of bodies without names or anatomy.

    A value out of range, or an unknown letter in ``kinds``, raises ConfigError.
    """

    seed: int = option(0, "Seed of the chain, the motion and every error.", (0, LARGEST))
    preset: Preset = option("default", "Size of noise and occlusions.")
    kinds: str = option("SS", "Joints from the base outwards: S ball, H hinge, T two-axis.")
    arc_deg: float = option(
        40.0, "Largest change of every joint coordinate from the start, degrees.", (0, 120), "degrees"
    )
    sway_mm: float = option(0.0, "Sway of the base, mm; 0 for a fixed base.", (0, 200), "mm")
    duration: float = option(20.0, "Duration, s.", (3, 600), "s")
    rate: float = option(100.0, "Frame rate, Hz.", (20, 2000), "Hz")
    soft_tissue_mm: float = option(0.0, "Largest sliding of the markers, mm.", (0, 50), "mm")
    markers: int = option(4, "Number of markers on every body.", (3, 20))

    def __post_init__(self) -> None:
        check_options(self, "simulate chain")
        if not 1 <= len(self.kinds) <= 8 or set(self.kinds) - set(KINDS):
            raise ConfigError(
                f"simulate chain: `kinds` is {self.kinds!r}; expected 1 … 8 of the letters {', '.join(KINDS)}"
            )
