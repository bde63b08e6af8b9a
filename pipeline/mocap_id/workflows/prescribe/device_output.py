"""Devices and controller of a prescription as JSON, and as lines of text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.pneumatics.switching import STEP
from mocap_id.pneumatics.unsafe_states import TransitionMap
from mocap_id.workflows.pneumatic.pressures import spring_document
from mocap_id.workflows.prescribe.chain_output import chain_lines
from mocap_id.workflows.prescribe.controlled_chain import ControlledChain
from mocap_id.workflows.prescribe.controlled_tasks import ControlledTasks
from mocap_id.workflows.prescribe.device_springs import DeviceSprings
from mocap_id.workflows.prescribe.result import PrescriptionResult


def devices_document(found: PrescriptionResult) -> dict[str, Any]:
    """Return the pressures of the devices, and the part of the prescribed range or workspace that is lost."""
    devices = found.devices
    assert devices is not None
    content: dict[str, Any] = {
        "springs": [
            {
                "joints": [joint + 1 for joint in found.places[each.place].joints],
                "device": each.device.keys.device,
                "flexion_Pa": each.setting.flexion,
                "extension_Pa": each.setting.extension,
                "nearest_spring": spring_document(each.nearest),
            }
            for each in devices.springs
        ],
        "why": "" if devices.springs else "no spring was prescribed in the place of a device",
    }
    if found.one is not None:
        lost = lost_range(found)
        content["range_deg"] = None if devices.range is None else np.degrees(devices.range).tolist()
        content["range_lost_deg"] = None if lost is None else float(np.degrees(lost))
    elif found.several is not None:
        content["functional_workspace_m2"] = devices.area
        content["functional_workspace_lost_m2"] = found.several.area - devices.area
    return content


def lost_range(found: PrescriptionResult) -> float | None:
    """Return how much narrower the held range is with the device than with the linear spring, rad."""
    assert found.one is not None and found.devices is not None
    if not found.devices.springs:
        return None
    kept = found.devices.range
    return float(np.ptp(found.one.range)) - (0.0 if kept is None else kept[1] - kept[0])


def controller_document(found: ControlledTasks) -> dict[str, Any]:
    """Return nodes, changes, tour and problems of the controller."""
    nodes, motion = found.controller.nodes, found.motion
    names = [node.name for node in nodes]
    return {
        "nodes": [
            {
                "name": node.name,
                "made_for_deg": np.degrees([low, high]).tolist(),
                "flexion_Pa": node.setting.flexion,
                "extension_Pa": node.setting.extension,
                "reserve_Nm": margin,
                "held_deg": _intervals(found.controller.angle, node.depth > 0),
            }
            for node, (_, low, high), margin in zip(nodes, found.tasks, found.margins, strict=True)
        ],
        "changes": [_transition(one, names) for one in found.maps],
        "tour": {
            "duration_s": float(motion.tour.time[-1]),
            "tasks": [
                {"task": visit.task, "start_s": visit.time[0], "held": visit.held, "missing_Nm": visit.missing}
                for visit in found.visits
            ],
            "changes": [
                {
                    "time_s": k * STEP,
                    "from": names[before],
                    "to": names[after],
                    "angle_deg": float(np.degrees(motion.angle[k])),
                    "gas_g": 1e3 * gas,
                }
                for (k, before, after), gas in zip(motion.switches, found.gas, strict=True)
            ],
            "gas_g": 1e3 * sum(found.gas),
            "shortest_dwell_s": found.shortest_dwell if np.isfinite(found.shortest_dwell) else None,
            "settling_s": found.settling,
        },
        "problems": list(found.problems),
    }


def _transition(one: TransitionMap, names: list[str]) -> dict[str, Any]:
    switched, still = one.switched, int(np.abs(one.velocity).argmin())
    return {
        "from": names[one.before],
        "to": names[one.after],
        "overlap_deg": np.degrees(one.angle[[0, -1]]).tolist(),
        "changes_deg": _intervals(one.angle, switched),
        "unsafe_share": float(one.unsafe[switched].mean()) if switched.any() else None,
        "unsafe_share_of_overlap": float(one.unsafe.mean()),
        "unsafe_at_rest_deg": _intervals(one.angle, one.unsafe[:, still]),
    }


def _intervals(angle: FloatArray, which: BoolArray) -> list[list[float]]:
    """Return the intervals of angles, in degrees."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], which, [False]]).astype(np.int8)))
    return [np.degrees([angle[a], angle[b - 1]]).tolist() for a, b in edges.reshape(-1, 2)]


def unsafe_states(found: ControlledTasks) -> Iterator[str]:
    """Yield the unsafe states as lines of a CSV file."""
    names = [node.name for node in found.controller.nodes]
    yield "from,to,angle_deg,velocity_deg_s,missing_Nm,controller_changes_here"
    for one in found.maps:
        for a, v in np.argwhere(one.unsafe):
            angle, velocity = np.degrees([one.angle[a], one.velocity[v]])
            way = f"{names[one.before]},{names[one.after]}"
            yield f"{way},{angle:.2f},{velocity:.2f},{one.excess[a, v]:.4f},{str(bool(one.switched[a])).lower()}"


def device_lines(found: PrescriptionResult) -> Iterator[str]:
    """Yield sentences about the devices and the controller."""
    devices = found.devices
    if devices is None:
        return
    for each in devices.springs:
        joints = " and ".join(found.body.joints[joint] for joint in found.places[each.place].joints)
        pressures = [
            f"{1e-5 * (pressure or 0.0):.2f} bar" for pressure in (each.setting.flexion, each.setting.extension)
        ]
        name = each.device.keys.device
        yield f"device {name} on {joints}: flexion {pressures[0]}, extension {pressures[1]} (absolute)"
    yield from _lost(found, devices)
    if isinstance(found.controlled, ControlledChain):
        yield from chain_lines(found.controlled)
    elif found.controlled is not None:
        yield from _controller(found.controlled)


def _lost(found: PrescriptionResult, devices: DeviceSprings) -> Iterator[str]:
    if not devices.springs:
        yield "device: no spring was prescribed in its place"
    elif found.one is not None:
        lost = lost_range(found)
        kept = "nothing" if devices.range is None else "{:.1f}° to {:.1f}°".format(*np.degrees(devices.range))
        yield f"with it {kept} can be held: {np.degrees(lost or 0.0):.1f}° less than with the linear spring"
    elif found.several is not None:
        less = found.several.area - devices.area
        yield f"with the devices {devices.area:.4f} m² can be held: {less:.4f} m² less than with linear springs"


def _controller(found: ControlledTasks) -> Iterator[str]:
    for node in found.controller.nodes:
        pressures = " and ".join(f"{1e-5 * pressure:.2f} bar" for pressure in node.setting.pressures())
        held = ", ".join(
            f"{low:.1f}° to {high:.1f}°" for low, high in _intervals(found.controller.angle, node.depth > 0)
        )
        yield f"node {node.name}: {pressures} hold {held}"
    motion = found.motion
    yield (
        f"tour of {motion.tour.time[-1]:.0f} s: {sum(visit.held for visit in found.visits)} of {len(found.visits)} "
        f"visits held, {len(motion.switches)} changes, {1e3 * sum(found.gas):.2f} g of gas"
    )
    yield from (f"problem: {problem}" for problem in found.problems)
