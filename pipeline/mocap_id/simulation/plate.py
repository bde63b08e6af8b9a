"""A simulated force plate: its position in the laboratory, and its channels under a given load.

The plate's own axes P are right-handed with z down. Its corners are listed in the order +x+y, -x+y, -x-y, +x-y of P.
ORIGIN points from the transducer to the centre of the working surface: M_sensor = M_surface + ORIGIN × F.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.recording.plate_types import PlateSignals

Sense: TypeAlias = Literal["reaction", "action"]
SIZE = (0.464, 0.508)  # m, along x and y of P
FORCE_NOISE = 1.0  # N
MOMENT_NOISE = 0.3  # N·m
FORCE_BIAS = 3.0  # N
MOMENT_BIAS = 0.3  # N·m


@dataclass(frozen=True)
class SimulatedPlate:
    """A force plate of type 2: six channels, forces and moments about the transducer."""

    sense: Sense  # whether it measures the force of the plate on the body (reaction) or the opposite (action)
    centre: FloatArray  # (3,) centre of the working surface in the laboratory, m
    yaw: float  # angle about the vertical between the laboratory's x axis and P's, rad
    origin: FloatArray  # (3,) ORIGIN in P, m
    flipped: bool  # whether the file contains -ORIGIN, like some old files
    bias: FloatArray  # (6,) constant error of forces, N, and transducer moments, N·m
    noise: float  # factor on FORCE_NOISE and MOMENT_NOISE

    @property
    def axes(self) -> FloatArray:
        """(3, 3) axes of P in the laboratory, as columns."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])

    @property
    def corners(self) -> FloatArray:
        """(4, 3) corners in the laboratory, m."""
        signs = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
        return self.centre + (signs * (SIZE[0] / 2, SIZE[1] / 2, 0.0)) @ self.axes.T


def draw_plate(
    rng: np.random.Generator, sense: Sense, *, moved: bool, flipped: bool, noise: float, bias: float
) -> SimulatedPlate:
    """Draw a plate at the laboratory's origin and along its axes; if ``moved``, it is shifted, lifted and rotated."""
    centre = np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.02, 0.02)])
    yaw = rng.uniform(-np.pi / 6, np.pi / 6)
    origin = np.array([*rng.normal(0, 0.0005, 2), -rng.uniform(0.035, 0.055)])
    scale = np.array([FORCE_BIAS] * 3 + [MOMENT_BIAS] * 3)
    return SimulatedPlate(
        sense=sense,
        centre=centre if moved else np.zeros(3),
        yaw=float(yaw) if moved else 0.0,
        origin=origin,
        flipped=flipped,
        bias=rng.normal(0, 1, 6) * scale * bias,
        noise=noise,
    )


def measure_load(
    rng: np.random.Generator, plate: SimulatedPlate, force: FloatArray, moment: FloatArray, rate: float
) -> PlateSignals:
    """Return the plate's noisy channels, as stored in a file with sampling rate ``rate``, Hz.

    ``force`` and ``moment`` (K, 3) act from the plate on the body, in laboratory axes, about the centre of the
    working surface, N and N·m.
    """
    sign = 1.0 if plate.sense == "reaction" else -1.0
    f, m = sign * force @ plate.axes, sign * moment @ plate.axes
    at_sensor = np.concatenate([f, m + np.cross(plate.origin, f)], axis=1)
    scale = plate.noise * np.array([FORCE_NOISE] * 3 + [MOMENT_NOISE] * 3)
    read: FloatArray = at_sensor + plate.bias + rng.normal(0, 1, at_sensor.shape) * scale
    in_file = -plate.origin if plate.flipped else plate.origin
    return PlateSignals(2, read, in_file, plate.corners, rate)
