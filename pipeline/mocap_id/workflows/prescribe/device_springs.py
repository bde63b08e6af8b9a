"""Pressures of pneumatic devices in place of the prescribed springs, and the range that is lost with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.config.device import DeviceConfig, load_device
from mocap_id.config.prescription import PrescriptionConfig
from mocap_id.pneumatics.cylinder import Cylinder, Setting
from mocap_id.pneumatics.held_angles import find_held_range, find_widest_setting
from mocap_id.pneumatics.nearest_spring import NearestSpring, find_nearest_setting
from mocap_id.prescription.one_joint import OneJoint
from mocap_id.prescription.one_spring import Prescription
from mocap_id.prescription.postures import Postures, SpringPlace
from mocap_id.prescription.several_springs import Springs, find_holdable


@dataclass(frozen=True)
class DeviceSpring:
    """A device in the place of a prescribed spring: the setting in use, and that of the nearest spring."""

    place: int
    device: DeviceConfig
    setting: Setting
    nearest: NearestSpring


@dataclass(frozen=True)
class DeviceSprings:
    """Devices in the places of the prescribed springs.

    Parameters
    ----------
    springs : tuple of DeviceSpring
        Empty if no spring was prescribed in a place with a device.
    range : (low, high) or None
        For one joint: the widest interval that can be held, rad.
    area : float
        For several joints: the functional workspace, m².
    """

    springs: tuple[DeviceSpring, ...]
    range: tuple[float, float] | None = None
    area: float = np.nan


def read_devices(config: PrescriptionConfig) -> tuple[DeviceConfig | None, ...]:
    """Return the device of each place for a spring.

    Raises
    ------
    ConfigError
        As for :func:`mocap_id.config.device.load_device`.
    """
    return tuple(
        None if spring.device is None else load_device(spring.device) for spring in config.wishes.springs or ()
    )


def device_of_joint(
    joint: OneJoint, found: Prescription, device: DeviceConfig, required: Sequence[float]
) -> DeviceSprings:
    """Return the pressures with which the person holds the widest interval of one joint.

    Raises
    ------
    ValueError
        The stroke allows no angle of the prescribed range.
    """
    if not found.helps:
        return DeviceSprings(())
    cylinder, limits = device.keys.cylinder(), device.keys.limits()
    angles = np.linspace(*found.range, 361)
    nearest = find_nearest_setting(cylinder, found.stiffness, found.rest, limits, angles)
    setting = find_widest_setting(joint, cylinder, limits, nearest.setting, required)
    spring = DeviceSpring(0, device, setting, nearest)
    return DeviceSprings((spring,), find_held_range(joint, cylinder, setting, required))


def devices_of_chain(
    postures: Postures,
    places: Sequence[SpringPlace],
    strength: FloatArray,
    found: Springs,
    devices: Sequence[DeviceConfig | None],
) -> DeviceSprings:
    """Return the pressures nearest to the prescribed springs over the held postures, and what can be held with them.

    Raises
    ------
    ValueError
        The stroke of a device allows none of the held postures.
    """
    held = find_holdable(postures, places, strength, found)
    needed, linear = postures.gravity.copy(), found.stiffness.copy()
    springs = []
    for s, device in enumerate(devices):
        if device is None or not found.stiffness[s] > 0:
            continue
        cylinder = device.keys.cylinder()
        stretch = postures.stretch[:, s]
        nearest = find_nearest_setting(
            cylinder, float(found.stiffness[s]), float(found.rest[s]), device.keys.limits(), stretch[held]
        )
        springs.append(DeviceSpring(s, device, nearest.setting, nearest))
        needed[:, list(places[s].joints)] -= _beyond_is_lost(cylinder, nearest.setting, stretch)[:, None]
        linear[s] = 0.0
    for s, place in enumerate(places):
        if linear[s] > 0:
            needed[:, list(place.joints)] += (linear[s] * (postures.stretch[:, s] - found.rest[s]))[:, None]
    kept: BoolArray = np.all((needed >= strength[:, 0]) & (needed <= strength[:, 1]), axis=1)
    cells = np.unique(postures.cell[kept & (postures.cell < postures.cells)])
    return DeviceSprings(tuple(springs), area=postures.size * len(cells))


def _beyond_is_lost(cylinder: Cylinder, setting: Setting, angle: FloatArray) -> FloatArray:
    """Return the torque of a device, N·m; infinite beyond the stroke, so that these postures are not held."""
    torque = cylinder.torque(angle, setting)
    return np.where(np.isnan(torque), np.inf, torque)
