"""Keys in the YAML file of a pneumatic device on one joint."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.cylinder import ADIABATIC, ISOTHERMAL, Cylinder, PressureLimits, Setting, compute_torque_and_sd
from mocap_id.stages.base import Settings

_Chamber = float | Literal["open"]
_SHARES = {
    "pulley_radius": ("pulley_radius_m", 0.01),
    "area_flexion": ("area_flexion_m2", 0.02),
    "area_extension": ("area_extension_m2", 0.02),
    "dead_flexion": ("dead_flexion_m", 0.1),
    "dead_extension": ("dead_extension_m", 0.1),
    "coulomb": ("coulomb_Nm", 0.5),
    "viscous": ("viscous_Nms", 0.5),
}  # field of the cylinder: key in the file, and default standard deviation as a share of the value
_Lag = Annotated[float, Field(gt=0)]
_CHAMBER = "absolute pressure at which it is sealed at full flexion, Pa, or `open` to the atmosphere"


class Condition(Settings):
    """State of both chambers of the device."""

    worn: bool = Field(True, description="false: the person does not wear the device")
    flexion_Pa: _Chamber = Field("open", description=f"flexion chamber: {_CHAMBER}")  # noqa: N815
    extension_Pa: _Chamber = Field("open", description=f"extension chamber: {_CHAMBER}")  # noqa: N815

    def setting(self) -> Setting:
        """Return the pressures at which the chambers are sealed; an open chamber has the pressure None."""
        return Setting(
            None if isinstance(self.flexion_Pa, str) else self.flexion_Pa,
            None if isinstance(self.extension_Pa, str) else self.extension_Pa,
        )


class Deviations(Settings):
    """Standard deviations of the values in the file of a device, for the standard deviation of its torque."""

    pulley_radius_m: float | None = Field(None, ge=0, description="m; default: 1 % of the radius")
    area_flexion_m2: float | None = Field(None, ge=0, description="m²; default: 2 % of the area")
    area_extension_m2: float | None = Field(None, ge=0, description="m²; default: 2 % of the area")
    dead_flexion_m: float | None = Field(None, ge=0, description="m; default: 10 % of the length")
    dead_extension_m: float | None = Field(None, ge=0, description="m; default: 10 % of the length")
    full_flexion_deg: float = Field(2.0, ge=0, description="degrees")
    polytropic: float = Field(0.1, ge=0, description="standard deviation of the exponent")
    coulomb_Nm: float | None = Field(None, ge=0, description="N·m; default: half of the friction")  # noqa: N815
    viscous_Nms: float | None = Field(None, ge=0, description="N·m·s/rad; default: half of the friction")  # noqa: N815
    gauge_Pa: float = Field(3000.0, ge=0, description="standard deviation of a sealed pressure, Pa")  # noqa: N815


class Settling(Settings):
    """Time constants of the pressures after a change of the condition."""

    fill_s: _Lag | tuple[_Lag, _Lag] = Field(
        0.2, description="time constant with which a chamber is filled, s; or of both chambers, [flexion, extension]"
    )
    vent_s: _Lag | tuple[_Lag, _Lag] = Field(
        0.2, description="time constant with which a chamber is vented, s; or of both chambers, [flexion, extension]"
    )

    def lags(self) -> tuple[FloatArray, FloatArray]:
        """Return the time constants for filling and for venting, s, each (2,) for flexion and extension chamber."""
        return np.broadcast_to(self.fill_s, 2), np.broadcast_to(self.vent_s, 2)


class Reservoir(Settings):
    """Reservoir of compressed air."""

    volume_m3: float = Field(gt=0, description="volume, m³")
    pressure_Pa: float = Field(gt=0, description="absolute pressure of the full reservoir, Pa")  # noqa: N815


class DeviceFile(Settings):
    """Keys in the file of a device."""

    device: str = Field(pattern=r"^\w[\w .+-]*$", max_length=100, description="name of the device")
    pulley_radius_m: float = Field(gt=0, lt=1, description="radius of the pulley at the joint, m")
    area_flexion_m2: float = Field(gt=0, lt=1, description="piston area of the chamber that flexes the joint, m²")
    area_extension_m2: float = Field(gt=0, lt=1, description="piston area of the chamber that extends the joint, m²")
    dead_flexion_m: float = Field(
        gt=0, lt=100, description="volume of ports and hoses of the flexion chamber divided by its piston area, m"
    )
    dead_extension_m: float = Field(
        gt=0, lt=100, description="volume of ports and hoses of the extension chamber divided by its piston area, m"
    )
    stroke_m: float = Field(gt=0, lt=10, description="stroke of the cylinder, m")
    full_flexion_deg: float = Field(
        description="joint angle at the flexed end of the stroke, where the chambers are sealed, degrees"
    )
    polytropic: float = Field(1.2, ge=ISOTHERMAL, le=ADIABATIC, description="exponent n: 1 if slow, 1.4 if fast")
    coulomb_Nm: float = Field(0.0, ge=0, description="Coulomb friction at the joint, N·m")  # noqa: N815
    viscous_Nms: float = Field(0.0, ge=0, description="viscous friction at the joint, N·m·s/rad")  # noqa: N815
    atmosphere_Pa: float = Field(101_325.0, gt=0, description="pressure of the atmosphere, Pa")  # noqa: N815
    supply_Pa: float = Field(gt=0, description="absolute pressure of the supply, Pa")  # noqa: N815
    temperature_K: float = Field(293.15, gt=0, description="temperature of the gas, K")  # noqa: N815
    sealed: Condition = Field(Condition(), description="state of the chambers")
    conditions: dict[str, Condition] = Field({}, description="states of the chambers by name, for example for a study")
    settling: Settling = Field(Settling(), description="time constants of the pressures")
    reservoir: Reservoir | None = Field(None, description="reservoir of the supply")
    sd: Deviations = Field(Deviations(), description="standard deviations of these values")

    def cylinder(self) -> Cylinder:
        """Return the cylinder of the device."""
        return Cylinder(
            self.pulley_radius_m,
            self.area_flexion_m2,
            self.area_extension_m2,
            self.dead_flexion_m,
            self.dead_extension_m,
            self.stroke_m,
            float(np.radians(self.full_flexion_deg)),
            self.polytropic,
            self.coulomb_Nm,
            self.viscous_Nms,
            self.atmosphere_Pa,
        )

    def limits(self) -> PressureLimits:
        """Return the lowest and highest pressure of a sealed chamber: atmosphere and supply."""
        return PressureLimits(self.atmosphere_Pa, self.supply_Pa)

    def deviations(self) -> dict[str, float]:
        """Return the standard deviations by field of the cylinder, and ``gauge``, that of a sealed pressure, Pa."""
        deviations = {"exponent": self.sd.polytropic, "gauge": self.sd.gauge_Pa}
        deviations["full_flexion"] = float(np.radians(self.sd.full_flexion_deg))
        for field, (key, share) in _SHARES.items():
            given = getattr(self.sd, key)
            deviations[field] = share * getattr(self, key) if given is None else given
        return deviations

    def torque(
        self,
        condition: Condition,
        angle: FloatArray,
        velocity: FloatArray | None = None,
        angle_deviation: FloatArray | float = 0.0,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the torque on the joint and its standard deviation, N·m; zeros if the device is not worn.

        The arguments are those of :func:`~mocap_id.dynamics.cylinder.compute_torque_and_sd`.
        """
        if not condition.worn:
            return np.zeros(np.shape(angle)), np.zeros(np.shape(angle))
        setting = condition.setting()
        return compute_torque_and_sd(self.cylinder(), setting, angle, self.deviations(), velocity, angle_deviation)
