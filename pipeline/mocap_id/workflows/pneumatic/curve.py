"""Torque, stiffness and rest angle of a device at the angles of its stroke."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from mocap_id import __version__
from mocap_id.config.device import DeviceConfig
from mocap_id.errors import ConfigError
from mocap_id.pneumatics.cylinder import ADIABATIC, ISOTHERMAL
from mocap_id.reporting.paper_figures import render
from mocap_id.reporting.pneumatic_figures import draw_curve
from mocap_id.reporting.results.columns import to_finite
from mocap_id.reporting.results.result import Result
from mocap_id.stages.device import Condition, DeviceFile

_NO_ZERO = "the torque is not zero at any angle of the stroke"
_NO_TORQUE = "the device gives no torque in this condition"


def device_curve(
    config: DeviceConfig, condition: Condition, exponent: float | None = None, angles: int = 181
) -> Result:
    """Return torque and stiffness of a device at equally spaced angles of its stroke.

    ``angles`` is their number. ``exponent`` replaces the polytropic exponent of the device.

    ConfigError is raised if the exponent is not between 1 and 1.4, or a pressure is not between zero and the pressure
    of the supply.
    """
    keys = _apply_exponent(config.keys, condition, exponent)
    cylinder, setting = keys.cylinder(), condition.setting()
    angle = np.linspace(*cylinder.limits, angles)
    torque, sd = keys.torque(condition, angle)
    none = np.zeros(angles)
    slow, fast = (
        cylinder.at_exponent(n).torque(angle, setting) if condition.worn else none for n in (ISOTHERMAL, ADIABATIC)
    )
    rest = cylinder.rest_angle(setting) if condition.worn else None
    friction = cylinder.coulomb if condition.worn else 0.0
    content = {
        "product": __version__,
        "device": keys.device,
        "flexion_Pa": setting.flexion,
        "extension_Pa": setting.extension,
        "polytropic": cylinder.exponent,
        "angle_rad": angle.tolist(),
        "torque_Nm": torque.tolist(),
        "sd_torque_Nm": sd.tolist(),
        "torque_isothermal_Nm": slow.tolist(),
        "torque_adiabatic_Nm": fast.tolist(),
        "torque_flexing_Nm": (torque - friction).tolist(),
        "torque_extending_Nm": (torque + friction).tolist(),
        "stiffness_Nm_rad": (cylinder.stiffness(angle, setting) if condition.worn else none).tolist(),
        "rest_angle_rad": to_finite(np.nan if rest is None else rest),
        "why": "" if rest is not None else _NO_ZERO if torque.any() else _NO_TORQUE,
    }

    def draw() -> Figure:
        return draw_curve(angle, torque, sd, (slow, fast), friction)

    return Result(
        "pneumatic-curve",
        "curve.json",
        content,
        other_files=lambda: render("curve", f"torque of the device: {keys.device}", draw),
    )


def _apply_exponent(keys: DeviceFile, condition: Condition, exponent: float | None) -> DeviceFile:
    """Return the device with the exponent; raise ConfigError if the exponent or a pressure is out of range."""
    if exponent is not None and not ISOTHERMAL <= exponent <= ADIABATIC:
        raise ConfigError(f"the exponent is {exponent:g}; expected 1 (isothermal) to 1.4 (adiabatic)")
    for pressure in (condition.flexion_Pa, condition.extension_Pa):
        if not isinstance(pressure, str) and not 0 < pressure <= keys.supply_Pa * (1 + 1e-9):
            supply = f"{keys.supply_Pa:g} Pa"
            raise ConfigError(
                f"a pressure is {pressure:g} Pa; expected an absolute pressure above 0, up to the supply's {supply}"
            )
    return keys if exponent is None else keys.model_copy(update={"polytropic": exponent})
