"""Options of a simulated robot in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from mocap_id.dynamics.space.calibration import SpatialCalibration, make_exact
from mocap_id.errors import ConfigError
from mocap_id.simulation.options import check_options, option
from mocap_id.simulation.plate import FORCE_BIAS, MOMENT_BIAS, SIZE

Preset = Literal["clean", "default"]
POSITION = 1e-3  # m: error of the plate's position in the default preset
SMALL_ERRORS = SpatialCalibration(
    gain=0.003,
    moments=0.003,
    force=FORCE_BIAS,
    moment=MOMENT_BIAS,
    position=POSITION,
    yaw=2 * POSITION / SIZE[0],
    lengths=0.001,
    tilt=0.002,
)
"""Standard deviations of the instruments' errors in the default preset."""


@dataclass(frozen=True)
class SpaceRobotOptions:
    """Options of a simulated robot in space, whose base stands on a force plate.

    A value out of range raises ConfigError.
    """

    seed: int = option(0, "Seed of robot and movement, which are the same with and without a payload.")
    preset: Preset = option("default", "clean: exact instruments; default: small errors.", choices=get_args(Preset))
    joints: int = option(2, "Number of hinges, 1 to 6.", (1, 6))
    payload: float = option(0.0, "Mass at the end of the last segment, kg.", (0, 100), "kg")
    duration: float = option(30.0, "Duration, s.", (5, 600), "s")
    rate: float = option(120.0, "Frames per second.", (30, 2000), "Hz")
    analog_rate: float = option(1200.0, "Plate samples per second, a multiple of the frame rate.")

    def __post_init__(self) -> None:
        check_options(self, "simulate robot-in-space")
        if not (self.analog_rate / self.rate).is_integer():
            raise ConfigError(
                f"simulate robot-in-space: analog_rate is {self.analog_rate:g} Hz; expected a multiple of the rate, "
                f"{self.rate:g} Hz"
            )

    @property
    def noise(self) -> float:
        """Factor on the noise of cameras and plate: 0 or 1."""
        return 0.0 if self.preset == "clean" else 1.0

    @property
    def errors(self) -> SpatialCalibration:
        """Standard deviations of the instruments' errors."""
        return make_exact() if self.preset == "clean" else SMALL_ERRORS
