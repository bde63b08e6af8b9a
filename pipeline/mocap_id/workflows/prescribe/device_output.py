"""Pneumatic devices of a prescription, as JSON and as lines of text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from mocap_id.workflows.pneumatic.pressures import spring_document
from mocap_id.workflows.prescribe.controller_output import controller_lines
from mocap_id.workflows.prescribe.device_springs import DeviceSprings
from mocap_id.workflows.prescribe.result import PrescriptionResult


def devices_document(result: PrescriptionResult) -> dict[str, Any]:
    """Return the pressures of the devices, and the range or workspace lost relative to the prescribed springs."""
    devices = result.devices
    assert devices is not None
    content: dict[str, Any] = {
        "springs": [
            {
                "joints": [joint + 1 for joint in result.places[each.place].joints],
                "device": each.device.keys.device,
                "flexion_Pa": each.setting.flexion,
                "extension_Pa": each.setting.extension,
                "nearest_spring": spring_document(each.nearest),
            }
            for each in devices.springs
        ],
        "why": "" if devices.springs else "no spring was prescribed for the joints of a device",
    }
    if result.one is not None:
        lost = _lost_range(result)
        content["range_deg"] = None if devices.range is None else np.degrees(devices.range).tolist()
        content["range_lost_deg"] = None if lost is None else float(np.degrees(lost))
    elif result.several is not None:
        content["functional_workspace_m2"] = devices.area
        content["functional_workspace_lost_m2"] = result.several.area - devices.area
    return content


def _lost_range(result: PrescriptionResult) -> float | None:
    """Return how much smaller the held range is with the device than with the linear spring, rad; None if unknown."""
    assert result.one is not None and result.devices is not None
    if not result.devices.springs:
        return None
    held = result.devices.range
    return float(np.ptp(result.one.range)) - (0.0 if held is None else held[1] - held[0])


def device_lines(result: PrescriptionResult) -> Iterator[str]:
    """Yield sentences about the devices and the controller."""
    devices = result.devices
    if devices is None:
        return
    for each in devices.springs:
        joints = " and ".join(result.body.joints[joint] for joint in result.places[each.place].joints)
        pressures = [
            f"{1e-5 * (pressure or 0.0):.2f} bar" for pressure in (each.setting.flexion, each.setting.extension)
        ]
        name = each.device.keys.device
        yield f"device {name} on {joints}: flexion {pressures[0]}, extension {pressures[1]} (absolute)"
    yield _loss_line(result, devices)
    if result.controlled is not None:
        yield from controller_lines(result.controlled)


def _loss_line(result: PrescriptionResult, devices: DeviceSprings) -> str:
    if not devices.springs:
        return "device: no spring was prescribed for the joints of the device"
    if result.several is not None:
        lost = result.several.area - devices.area
        return f"with the devices, {devices.area:.4f} m² can be held: {lost:.4f} m² less than with linear springs"
    lost_range = np.degrees(_lost_range(result) or 0.0)
    held = "nothing" if devices.range is None else "{:.1f}° to {:.1f}°".format(*np.degrees(devices.range))
    return f"with the device, {held} can be held: {lost_range:.1f}° less than with the linear spring"
