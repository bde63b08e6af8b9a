"""Pressures of pneumatic devices that replace the prescribed springs, and the remaining range or workspace."""

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
    """A device that replaces a prescribed spring."""

    place: int  # index of the spring among the possible springs
    device: DeviceConfig
    setting: Setting  # the pressures in use
    nearest: NearestSpring  # the pressures that best approximate the prescribed spring


@dataclass(frozen=True)
class DeviceSprings:
    """Devices that replace the prescribed springs."""

    springs: tuple[DeviceSpring, ...]  # empty if no spring was prescribed for the joints of a device
    range: tuple[float, float] | None = None  # for one joint: the widest interval that can be held, rad; else None
    area: float = np.nan  # for several joints: the functional workspace, m²


def read_devices(config: PrescriptionConfig) -> tuple[DeviceConfig | None, ...]:
    """Return the device of each possible spring; None for a spring without a device.

    ConfigError is raised as for :func:`mocap_id.config.device.load_device`.
    """
    return tuple(
        None if spring.device is None else load_device(spring.device) for spring in config.wishes.springs or ()
    )


def fit_joint_device(
    joint: OneJoint, prescribed: Prescription, device: DeviceConfig, required: Sequence[float]
) -> DeviceSprings:
    """Return the pressures with which the person holds the widest interval of one joint.

    The interval contains the ``required`` angles, rad. ValueError is raised if the stroke contains no angle of the
    prescribed range.
    """
    if not prescribed.helps:
        return DeviceSprings(())
    cylinder, limits = device.keys.cylinder(), device.keys.limits()
    angles = np.linspace(*prescribed.range, 361)
    nearest = find_nearest_setting(cylinder, prescribed.stiffness, prescribed.rest, limits, angles)
    setting = find_widest_setting(joint, cylinder, limits, nearest.setting, required)
    spring = DeviceSpring(0, device, setting, nearest)
    return DeviceSprings((spring,), find_held_range(joint, cylinder, setting, required))


def fit_chain_devices(
    postures: Postures,
    places: Sequence[SpringPlace],
    strength: FloatArray,
    prescribed: Springs,
    devices: Sequence[DeviceConfig | None],
) -> DeviceSprings:
    """Return the pressures that best approximate the prescribed springs, and the workspace with these pressures.

    The torques are compared in the postures that the prescribed springs hold. ValueError is raised if the stroke of a
    device contains none of these postures.
    """
    held = find_holdable(postures, places, strength, prescribed)
    needed, linear = postures.gravity.copy(), prescribed.stiffness.copy()
    springs = []
    for s, device in enumerate(devices):
        if device is None or not prescribed.stiffness[s] > 0:
            continue
        cylinder = device.keys.cylinder()
        stretch = postures.stretch[:, s]
        nearest = find_nearest_setting(
            cylinder, float(prescribed.stiffness[s]), float(prescribed.rest[s]), device.keys.limits(), stretch[held]
        )
        springs.append(DeviceSpring(s, device, nearest.setting, nearest))
        needed[:, list(places[s].joints)] -= _torque_in_stroke(cylinder, nearest.setting, stretch)[:, None]
        linear[s] = 0.0
    for s, place in enumerate(places):
        if linear[s] > 0:
            needed[:, list(place.joints)] += (linear[s] * (postures.stretch[:, s] - prescribed.rest[s]))[:, None]
    kept: BoolArray = np.all((needed >= strength[:, 0]) & (needed <= strength[:, 1]), axis=1)
    cells = np.unique(postures.cell[kept & (postures.cell < postures.cells)])
    return DeviceSprings(tuple(springs), area=postures.size * len(cells))


def _torque_in_stroke(cylinder: Cylinder, setting: Setting, angle: FloatArray) -> FloatArray:
    """Return the torque of a device, N·m; infinite beyond the stroke, so that these postures are not held."""
    torque = cylinder.torque(angle, setting)
    return np.where(np.isnan(torque), np.inf, torque)
