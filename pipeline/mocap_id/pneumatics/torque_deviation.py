"""Torque of a described device with its standard deviation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.pneumatics.cylinder import Cylinder, Setting


def compute_torque_and_sd(  # noqa: PLR0917
    cylinder: Cylinder,
    setting: Setting,
    angle: FloatArray,
    sds: Mapping[str, float],
    velocity: FloatArray | None = None,
    angle_sd: FloatArray | float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Return the torque of a device on the joint and its standard deviation, (N,) each, N·m.

    The errors of the description are independent of each other and constant over the angles. The errors of neighbouring
    samples are therefore the same, not independent.

    Parameters
    ----------
    cylinder : Cylinder
    setting : Setting
    angle : (N,) array
        Angles, rad; beyond the stroke both results are NaN.
    sds : mapping of str to float
        Standard deviations of fields of :class:`Cylinder`, and ``gauge`` of each sealed pressure, Pa.
    velocity : (N,) array, optional
        Velocities, rad/s; without them the torque excludes friction, but its standard deviation includes Coulomb
        friction.
    angle_sd : (N,) array or float
        Standard deviation of the angle, rad.
    """
    angle = np.asarray(angle, dtype=np.float64)

    def torque(one: Cylinder) -> FloatArray:  # also slightly beyond the stroke of a changed cylinder
        friction = 0.0 if velocity is None else one.friction(velocity)
        by_pressure = one.torque_by_pressure(angle, setting.sealed)
        return np.asarray(by_pressure @ setting.pressures() + one.torque_of_atmosphere(setting.sealed) + friction)

    variance = (cylinder.stiffness(angle, setting) * angle_sd) ** 2
    if velocity is None:
        variance = variance + cylinder.coulomb**2 / 3  # uniform between flexing and extending
    for name, sd in sds.items():
        if name == "gauge":
            by_pressure = cylinder.torque_by_pressure(angle, setting.sealed)
            variance = variance + (by_pressure**2).sum(axis=-1) * sd**2
            continue
        value = getattr(cylinder, name)
        step = min(0.1 * sd, 0.5 * abs(value))
        if step == 0:
            continue
        more, less = (torque(replace(cylinder, **{name: value + change})) for change in (step, -step))
        variance = variance + ((more - less) / (2 * step) * sd) ** 2
    inside = cylinder.allows(angle)
    return np.where(inside, torque(cylinder), np.nan), np.where(inside, np.sqrt(variance), np.nan)
