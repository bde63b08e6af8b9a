"""The pneumatic device of simulated curls: its description for the user, and its true torque."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.stages.device import Condition, DeviceFile

CurlCondition: TypeAlias = Literal["C", "AC", "2", "3", "4", "5"]
"""Conditions of thesis figure 8.5: without the device, with open chambers, and the modes of the device."""
_HIGH, _ATMOSPHERE = 446_063.0, 101_325.0  # Pa, absolute: 50 psi above the atmosphere, and the atmosphere
DEVICE = DeviceFile(
    device="simulated-elbow",
    pulley_radius_m=0.03,
    area_flexion_m2=2.835e-4,
    area_extension_m2=2.552e-4,
    dead_flexion_m=0.09,
    dead_extension_m=0.09,
    stroke_m=0.08,
    full_flexion_deg=150,
    polytropic=1.2,
    coulomb_Nm=0.2,
    viscous_Nms=0.02,
    supply_Pa=700_000,
    conditions={
        "C": Condition(worn=False),
        "AC": Condition(),
        "2": Condition(flexion_Pa=_ATMOSPHERE, extension_Pa=_HIGH),
        "3": Condition(flexion_Pa=_ATMOSPHERE, extension_Pa=_ATMOSPHERE),
        "4": Condition(flexion_Pa=_HIGH, extension_Pa=_HIGH),
        "5": Condition(flexion_Pa=_HIGH, extension_Pa=_ATMOSPHERE),
    },
)
"""Description of the device; its sizes are assumed, because the thesis publishes none."""


def device_yaml() -> bytes:
    """Return the content of the device's YAML file."""
    keys = DEVICE.model_dump(mode="json", exclude_defaults=True)
    return "".join(f"{name}: {json.dumps(value)}\n" for name, value in keys.items()).encode()


def device_torque(seed: int, condition: CurlCondition, angle: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return the torque (T,) of the device on the elbow, N·m, for flexion ``angle``, rad, and ``velocity``, rad/s.

    The true cylinder differs from the description by random errors with the standard deviations of the description. The
    same seed gives the same cylinder.
    """
    state = DEVICE.conditions[condition]
    if not state.worn:
        return np.zeros(len(angle))
    rng = np.random.default_rng([seed, 30])
    cylinder, setting = DEVICE.cylinder(), state.setting()
    errors = {name: float(rng.normal(0, sd)) for name, sd in DEVICE.deviations().items()}
    gauge = errors.pop("gauge")
    true = replace(cylinder, **{name: max(getattr(cylinder, name) + error, 0.0) for name, error in errors.items()})
    true = replace(true, exponent=float(np.clip(true.exponent, 1.0, 1.4)))
    sealed = [None if pressure is None else pressure + gauge for pressure in (setting.flexion, setting.extension)]
    spring = true.torque(angle, replace(setting, flexion=sealed[0], extension=sealed[1]))
    return np.asarray(spring + true.friction(velocity))
