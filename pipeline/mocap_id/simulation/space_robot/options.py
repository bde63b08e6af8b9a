"""Options of a simulated robot in space."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from mocap_id.dynamics.space.calibration import SpatialCalibration, no_errors
from mocap_id.errors import ConfigError
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

    Parameters
    ----------
    seed : int
        The same seed gives the same robot and movement, with or without a payload.
    preset : {"clean", "default"}
        Without errors of the instruments, or with small ones.
    joints : int
        Number of hinges, 1 to 6.
    payload : float
        Mass at the end of the last segment, kg.
    duration : float
        s.
    rate, analog_rate : float
        Frames and plate samples per second.

    Raises
    ------
    ConfigError
        A value is out of range.
    """

    seed: int = field(default=0, metadata={"help": "Robot and movement; the same with or without a payload."})
    preset: Preset = field(default="default", metadata={"help": "clean: exact instruments; default: small errors."})
    joints: int = field(default=2, metadata={"help": "Number of hinges, 1 to 6."})
    payload: float = field(default=0.0, metadata={"help": "Mass at the end of the last segment, kg."})
    duration: float = field(default=30.0, metadata={"help": "Duration, s."})
    rate: float = field(default=120.0, metadata={"help": "Frames per second."})
    analog_rate: float = field(default=1200.0, metadata={"help": "Plate samples per second."})

    def __post_init__(self) -> None:
        limits = {"joints": (1, 6), "payload": (0, 100), "duration": (5, 600), "rate": (30, 2000)}
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(f"simulate robot-in-space: {name} is {value!r}, expected {low} … {high}")
        if self.preset not in ("clean", "default"):
            raise ConfigError(f"simulate robot-in-space: preset is {self.preset!r}, expected clean or default")
        if not (self.analog_rate / self.rate).is_integer():
            raise ConfigError(
                f"simulate robot-in-space: analog_rate is {self.analog_rate:g} Hz, expected a multiple of the rate, "
                f"{self.rate:g} Hz"
            )

    @property
    def noise(self) -> float:
        """Factor on the noise of cameras and plate: 0 or 1."""
        return 0.0 if self.preset == "clean" else 1.0

    @property
    def errors(self) -> SpatialCalibration:
        """Standard deviations of the instruments' errors."""
        return no_errors() if self.preset == "clean" else SMALL_ERRORS
