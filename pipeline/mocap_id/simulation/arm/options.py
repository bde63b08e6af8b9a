"""Options of simulated trials in space: one field each, with its default, limits and help text.

The command line and its documentation are generated from these fields.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from mocap_id.errors import ConfigError
from mocap_id.simulation.options import LARGEST, check_options, option

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
    preset: Preset = option("default", "Size of noise, soft tissue, palpation error and occlusions.", choices=PRESETS)
    movement: Movement = option("reach", "Functional reaches, or curls on a bench.", choices=get_args(Movement))
    side: Side = option("right", "Arm that carries the markers.", choices=get_args(Side))
    severity: float = option(0.3, "Limitation of the reaches: 0 healthy, 1 almost no reach.", (0, 1))
    cycles: int = option(2, "Number of rounds of all reaches.", (1, 20))
    repetitions: int = option(8, "Number of curls.", (1, 100))
    failed: int = option(0, "Number of failed curls at the end.", (0, 20))
    compensation: float = option(0.25, "Size of the compensating shoulder motion in tired curls.", (0, 2))
    condition: CurlCondition = option(
        "C",
        "Curls without the pneumatic device (C), with open chambers (AC), or in one of its modes.",
        choices=get_args(CurlCondition),
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
    preset: Preset = option("default", "Size of noise and occlusions.", choices=PRESETS)
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
