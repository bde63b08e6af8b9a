"""A simulated force plate: its position in the laboratory, and its channels under a given load.

The plate's own frame P is right-handed with z down. Its corners are listed in the order +x+y, -x+y, -x-y, +x-y of P.
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
    """A force plate of type 2: six channels, forces and moments about the transducer.

    Parameters
    ----------
    sense : {"reaction", "action"}
        Sign convention: force of the plate on the body, or of the body on the plate.
    centre : (3,) array
        Centre of the working surface in the laboratory, m.
    yaw : float
        Angle about the vertical between the laboratory's x axis and P's, rad.
    origin : (3,) array
        ORIGIN in P, m.
    flipped : bool
        Whether the file holds -ORIGIN, as some old files do.
    bias : (6,) array
        Added to forces (N) and transducer moments (N·m).
    noise : float
        Factor on :data:`FORCE_NOISE` and :data:`MOMENT_NOISE`.
    """

    sense: Sense
    centre: FloatArray
    yaw: float
    origin: FloatArray
    flipped: bool
    bias: FloatArray
    noise: float

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
    """Draw a plate at the laboratory's origin and aligned with its axes, or ``moved``: shifted, lifted and turned."""
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


def measure(
    rng: np.random.Generator, plate: SimulatedPlate, force: FloatArray, moment: FloatArray, rate: float
) -> PlateSignals:
    """Return the plate's noisy channels, as stored in a file.

    Parameters
    ----------
    rng : Generator
    plate : SimulatedPlate
    force, moment : (K, 3) arrays
        Force and moment of the plate on the body in laboratory axes, about the working surface's centre, N and N·m.
    rate : float
        Sampling rate, Hz.

    Returns
    -------
    PlateSignals
    """
    sign = 1.0 if plate.sense == "reaction" else -1.0
    f, m = sign * force @ plate.axes, sign * moment @ plate.axes
    at_sensor = np.concatenate([f, m + np.cross(plate.origin, f)], axis=1)
    scale = plate.noise * np.array([FORCE_NOISE] * 3 + [MOMENT_NOISE] * 3)
    read: FloatArray = at_sensor + plate.bias + rng.normal(0, 1, at_sensor.shape) * scale
    in_file = -plate.origin if plate.flipped else plate.origin
    return PlateSignals(2, read, in_file, plate.corners, rate)
