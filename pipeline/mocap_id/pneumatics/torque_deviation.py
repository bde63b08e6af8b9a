"""Torque of a described device with its standard deviation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.pneumatics.cylinder import Cylinder, Setting


def torque_and_deviation(  # noqa: PLR0917
    cylinder: Cylinder,
    setting: Setting,
    angle: FloatArray,
    deviations: Mapping[str, float],
    velocity: FloatArray | None = None,
    angle_deviation: FloatArray | float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Return the torque of a device on the joint, and its standard deviation, N·m.

    The deviations are independent of each other and constant over the angles, so the errors of neighbouring samples
    are the same, not independent.

    Parameters
    ----------
    cylinder : Cylinder
    setting : Setting
    angle : (N,) array
        rad; beyond the stroke both results are NaN.
    deviations : mapping of str to float
        Standard deviations of fields of :class:`Cylinder`, and ``gauge`` of each sealed pressure, Pa.
    velocity : (N,) array, optional
        rad/s; without it the result has no friction, but the deviation contains the Coulomb friction.
    angle_deviation : (N,) array or float
        Standard deviation of the angle, rad.
    """
    angle = np.asarray(angle, dtype=np.float64)

    def torque(of: Cylinder) -> FloatArray:  # also a little beyond the stroke of a changed cylinder
        rub = 0.0 if velocity is None else of.friction(velocity)
        by_pressure = of.torque_by_pressure(angle, setting.sealed)
        return np.asarray(by_pressure @ setting.pressures() + of.torque_of_atmosphere(setting.sealed) + rub)

    variance = (cylinder.stiffness(angle, setting) * angle_deviation) ** 2
    if velocity is None:
        variance = variance + cylinder.coulomb**2 / 3  # evenly between flexing and extending
    for name, deviation in deviations.items():
        if name == "gauge":
            by_pressure = cylinder.torque_by_pressure(angle, setting.sealed)
            variance = variance + (by_pressure**2).sum(axis=-1) * deviation**2
            continue
        value = getattr(cylinder, name)
        step = min(0.1 * deviation, 0.5 * abs(value))
        if step == 0:
            continue
        more, less = (torque(replace(cylinder, **{name: value + change})) for change in (step, -step))
        variance = variance + ((more - less) / (2 * step) * deviation) ** 2
    inside = cylinder.within(angle)
    return np.where(inside, torque(cylinder), np.nan), np.where(inside, np.sqrt(variance), np.nan)
