"""The files of a prescription (JSON document, tables, figures), and the sentences about it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mocap_id import __version__
from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.reporting.paper_figures import render
from mocap_id.reporting.results.columns import to_finite
from mocap_id.reporting.results.result import Result, make_text_file
from mocap_id_assist.assisted_body import DeviceSprings, PrescriptionResult, SpringMap, Timed
from mocap_id_assist.controllers import STEP, TOUR_STEP, TransitionMap
from mocap_id_assist.device_control import ChainChange, ControlledChain, ControlledTasks
from mocap_id_assist.figures import (
    draw_chain_tour,
    draw_holdable_postures,
    draw_level_sets,
    draw_ranges,
    draw_spring_map,
    draw_switching,
)
from mocap_id_assist.pneumatic import spring_document
from mocap_id_assist.several_joints import Graph, find_held_postures
from mocap_id_assist.workspaces import workspace_result


def prescription_output(found: PrescriptionResult) -> Result:
    """Return ``prescription.json``, and the tables and figures of all computed parts.

    In the document, `springs` is null if no springs could be prescribed; `why` is then the reason.
    """
    body = found.body
    content: dict[str, Any] = {
        "product": __version__,
        "prescription": found.config.wishes.prescription,
        "joints": [
            {
                "name": name,
                "limits_deg": _degrees((body.limits.lower[j], body.limits.upper[j])),
                "strength_Nm": [to_finite(value) for value in body.strength[j]],
            }
            for j, name in enumerate(body.joints)
        ],
        "why": found.refused,
        "springs": None,
    }
    if found.workspace is not None:
        content["workspace"] = workspace_result(found.workspace).document
    if found.one is not None and found.joint is not None:
        content |= _one_joint(found)
    if found.several is not None:
        content |= _several_joints(found)
    if found.timed is not None:
        content["level_set"] = _level_set(found.timed)
    if found.map is not None:
        content["search"] = _spring_map(found.map)
    if found.graph is not None and found.graph_postures is not None:
        content["sub_workspaces"] = _graph(found.graph, found.graph_postures)
    if found.devices is not None:
        content["devices"] = devices_document(found)
    if found.controlled is not None:
        content["controller"] = controller_document(found.controlled)
    return Result("prescription", "prescription.json", content, other_files=lambda: _files(found), end="")


def _files(found: PrescriptionResult) -> dict[str, bytes]:
    files: dict[str, bytes] = {}
    name = found.config.wishes.prescription
    one, joint, timed, springs = found.one, found.joint, found.timed, found.map
    if one is not None and joint is not None:
        files |= render("range", f"range with and without a spring: {name}", lambda: draw_ranges(joint, one))
    if found.postures is not None and found.several is not None:
        files |= render("functional", f"holdable postures: {name}", lambda: _draw_holdable(found))
    if timed is not None:
        files |= render(
            "level_set",
            f"reachable set over time: {name}",
            lambda: draw_level_sets(timed.reached, timed.bounds, timed.dynamics),
        )
        files["horizons.csv"] = make_text_file(_horizon_rows(timed))
    if springs is not None:
        files |= render(
            "search",
            f"springs by their reachable sets: {name}",
            lambda: draw_spring_map(springs.stiffness, springs.rest, springs.width, springs.horizon),
        )
        files["search.csv"] = make_text_file(_spring_rows(springs))
    if found.controlled is not None:
        files |= _controller_files(found.controlled, name)
    return files


def _controller_files(controlled: ControlledTasks | ControlledChain, name: str) -> dict[str, bytes]:
    title = f"controller over sub-workspaces: {name}"
    if isinstance(controlled, ControlledChain):
        names = [node.name for node in controlled.nodes]
        files = render("controller", title, lambda: draw_chain_tour(controlled.tour, names))
        return files | {"unsafe_postures.csv": make_text_file(unsafe_postures(controlled))}
    joint = controlled.person.joint
    limits = (joint.torque_low, joint.torque_high)
    files = render(
        "controller",
        title,
        lambda: draw_switching(controlled.controller, controlled.motion, limits, controlled.maps),
    )
    return files | {"unsafe_states.csv": make_text_file(unsafe_states(controlled))}


def _draw_holdable(found: PrescriptionResult) -> Figure:
    springs, sampled, strength = found.several, found.postures, found.body.strength
    assert springs is not None and sampled is not None
    none = find_held_postures(sampled, (), strength, springs)
    return draw_holdable_postures(
        sampled.tips, none, find_held_postures(sampled, found.places, strength, springs), found.body.arm.centres[0]
    )


def _one_joint(found: PrescriptionResult) -> dict[str, Any]:
    one, joint = found.one, found.joint
    assert one is not None and joint is not None
    spring = {"joints": [1], "stiffness_Nm_per_rad": one.stiffness, "rest_deg": to_finite(np.degrees(one.rest))}
    return {
        "helps": one.helps,
        "springs": [spring] if one.helps else [],
        "moment_of_gravity_Nm": joint.weight,
        "range_deg": _degrees(one.range),
        "range_without_deg": None if one.without is None else _degrees(one.without),
        "gap_deg": float(np.degrees(one.gap)),
    }


def _several_joints(found: PrescriptionResult) -> dict[str, Any]:
    springs = found.several
    assert springs is not None
    return {
        "helps": springs.helps,
        "springs": [
            {
                "joints": [joint + 1 for joint in place.joints],
                "stiffness_Nm_per_rad": float(springs.stiffness[s]),
                "rest_deg": to_finite(np.degrees(springs.rest[s])),
            }
            for s, place in enumerate(found.places)
            if springs.stiffness[s] > 0
        ],
        "functional_workspace_m2": springs.area,
        "functional_workspace_without_m2": springs.without,
        "reachable_m2": springs.reachable,
        "gap_m2": springs.gap,
        "boxes": springs.boxes,
    }


def _level_set(timed: Timed) -> dict[str, Any]:
    start = timed.dynamics.equilibrium()
    return {
        "stiffness_Nm_per_rad": timed.dynamics.stiffness,
        "rest_deg": to_finite(np.degrees(timed.dynamics.rest)),
        "inertia_kgm2": timed.dynamics.inertia,
        "equilibrium_deg": None if start is None else float(np.degrees(start)),
        "static_deg": None if timed.static is None else _degrees(timed.static),
        "unheld_deg": [_degrees(each) for each in timed.unheld],
        "horizons": [
            {
                "time_s": time,
                "reached_and_held_deg": None if bound is None else _degrees(bound),
                "grid_error_deg": None if error is None else to_finite(np.degrees(error)),
            }
            for time, bound, error in zip(timed.reached.times, timed.bounds, timed.grid_errors, strict=True)
        ],
    }


def _spring_map(springs: SpringMap) -> dict[str, Any]:
    best = springs.best
    found = None
    if best is not None:
        k, r = best
        found = {
            "stiffness_Nm_per_rad": float(springs.stiffness[k]),
            "rest_deg": float(np.degrees(springs.rest[r])),
            "reached_and_held_deg": float(np.degrees(springs.width[k, r])),
        }
    return {"horizon_s": springs.horizon, "springs": int(springs.width.size), "best": found}


def _graph(graph: Graph, postures: Any) -> dict[str, Any]:
    names = [node.name for node in graph.nodes]
    count = range(len(names))
    ways = {(a, b): graph.find_path(a, b) for a in count for b in count if a < b}
    return {
        "nodes": [
            {
                "name": node.name,
                "tasks": list(node.tasks),
                "springs": None
                if node.stiffness is None or node.rest is None
                else [
                    {"stiffness_Nm_per_rad": float(k), "rest_deg": to_finite(np.degrees(rest))}
                    for k, rest in zip(node.stiffness, node.rest, strict=True)
                ],
                "held_share": float(node.held.mean()),
            }
            for node in graph.nodes
        ],
        "switches": [
            {
                "between": [names[k] for k in switch.between],
                "overlap_share": switch.share,
                "at_deg": np.degrees(postures[switch.posture]).tolist(),
            }
            for switch in graph.switches
        ],
        "ways": [
            {"from": names[a], "to": names[b], "by": None if way is None else [names[k] for k in way]}
            for (a, b), way in ways.items()
        ],
    }


def _horizon_rows(timed: Timed) -> Iterator[str]:
    yield "time_s,lower_deg,upper_deg"
    for time, bound in zip(timed.reached.times, timed.bounds, strict=True):
        yield ",".join([f"{time:g}", *("" if bound is None else f"{np.degrees(end):.3f}" for end in bound or (0, 0))])


def _spring_rows(springs: SpringMap) -> Iterator[str]:
    yield "stiffness_Nm_per_rad,rest_deg,reached_and_held_deg,held_deg"
    for k, stiffness in enumerate(springs.stiffness):
        for r, rest in enumerate(np.degrees(springs.rest)):
            width, static = np.degrees([springs.width[k, r], springs.static[k, r]])
            reached = "" if np.isnan(width) else f"{width:.3f}"
            yield f"{stiffness:.6g},{rest:.6g},{reached},{static:.3f}"


def _degrees(pair: tuple[float, float]) -> list[float]:
    return [float(np.degrees(pair[0])), float(np.degrees(pair[1]))]


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


def controller_document(controlled: ControlledTasks | ControlledChain) -> dict[str, Any]:
    """Return nodes, changes, tour and problems of a controller as JSON values."""
    if isinstance(controlled, ControlledChain):
        return _chain_document(controlled)
    return _joint_document(controlled)


def _joint_document(controlled: ControlledTasks) -> dict[str, Any]:
    nodes, motion = controlled.controller.nodes, controlled.motion
    names = [node.name for node in nodes]
    visits = [
        {"task": visit.task, "start_s": visit.time[0], "held": visit.held, "missing_Nm": visit.missing}
        for visit in controlled.visits
    ]
    steps = _change_rows(controlled, STEP, names, lambda k: {"angle_deg": float(np.degrees(motion.angle[k]))})
    return {
        "nodes": [
            {
                "name": node.name,
                "made_for_deg": np.degrees([low, high]).tolist(),
                "flexion_Pa": node.setting.flexion,
                "extension_Pa": node.setting.extension,
                "reserve_Nm": margin,
                "held_deg": _intervals(controlled.controller.angle, node.depth > 0),
            }
            for node, (_, low, high), margin in zip(nodes, controlled.tasks, controlled.margins, strict=True)
        ],
        "changes": [_transition(one, names) for one in controlled.maps],
        "tour": _tour(controlled, float(motion.tour.time[-1]), visits, steps),
        "problems": list(controlled.problems),
    }


def _chain_document(controlled: ControlledChain) -> dict[str, Any]:
    tour, names = controlled.tour, [node.name for node in controlled.nodes]
    visits = [
        {
            "task": controlled.stops[stop],
            "start_s": start * TOUR_STEP,
            "at_deg": np.degrees(tour.q[start]).tolist(),
            "held": missing <= controlled.tolerance,
            "missing_Nm": missing,
        }
        for (stop, start, _), missing in zip(tour.visits, controlled.missing, strict=True)
    ]
    steps = _change_rows(controlled, TOUR_STEP, names, lambda k: {"at_deg": np.degrees(tour.q[k]).tolist()})
    return {
        "nodes": [
            {
                "name": node.name,
                "devices": [
                    {"joints": [joint + 1 for joint in one.joints], "flexion_Pa": gas[0], "extension_Pa": gas[1]}
                    for one, gas in zip(controlled.chain.actuators, node.pressures.tolist(), strict=True)
                ],
                "reserve_share": margin,
                "held_share": float(share),
            }
            for node, margin, share in zip(controlled.nodes, controlled.margins, controlled.held, strict=True)
        ],
        "changes": [_chain_change(one, names) for one in controlled.changes],
        "tour": _tour(controlled, float(tour.time[-1]), visits, steps, {"missing_Nm": float(tour.excess.max())}),
        "problems": list(controlled.problems),
    }


def _change_rows(
    controlled: ControlledTasks | ControlledChain,
    step: float,
    names: Sequence[str],
    position: Callable[[int], dict[str, Any]],
) -> list[dict[str, Any]]:
    """Return the changes in the tour; ``position`` returns the angles of the joints at a sample."""
    return [
        {"time_s": k * step, "from": names[before], "to": names[after], **position(k), "gas_g": 1e3 * gas}
        for (k, before, after), gas in zip(controlled.switches, controlled.gas, strict=True)
    ]


def _tour(
    controlled: ControlledTasks | ControlledChain,
    duration: float,
    visits: list[dict[str, Any]],
    changes: list[dict[str, Any]],
    more: dict[str, Any] | None = None,
) -> dict[str, Any]:
    return {
        "duration_s": duration,
        "tasks": visits,
        "changes": changes,
        **(more or {}),
        "gas_g": 1e3 * sum(controlled.gas),
        "shortest_dwell_s": to_finite(controlled.shortest_dwell),
        "settling_s": controlled.settling,
    }


def _transition(one: TransitionMap, names: Sequence[str]) -> dict[str, Any]:
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


def _chain_change(one: ChainChange, names: Sequence[str]) -> dict[str, Any]:
    return {
        "from": names[one.before],
        "to": names[one.after],
        "postures": len(one.q),
        "unsafe_share": float(one.unsafe[one.switched].mean()) if one.switched.any() else None,
        "unsafe_share_of_overlap": float(one.unsafe.mean()),
    }


def _intervals(angle: FloatArray, which: BoolArray) -> list[list[float]]:
    """Return the intervals of ``angle``, rad, in which ``which`` is true, in degrees."""
    return [np.degrees([angle[run.start], angle[run.stop - 1]]).tolist() for run in find_runs(which)]


def unsafe_states(controlled: ControlledTasks) -> Iterator[str]:
    """Yield the lines of a CSV file with the states of a joint in which a change is unsafe."""
    names = [node.name for node in controlled.controller.nodes]
    yield "from,to,angle_deg,velocity_deg_s,missing_Nm,controller_changes_here"
    for one in controlled.maps:
        for a, v in np.argwhere(one.unsafe):
            angle, velocity = np.degrees([one.angle[a], one.velocity[v]])
            change = f"{names[one.before]},{names[one.after]}"
            yield f"{change},{angle:.2f},{velocity:.2f},{one.excess[a, v]:.4f},{str(bool(one.switched[a])).lower()}"


def unsafe_postures(controlled: ControlledChain) -> Iterator[str]:
    """Yield the lines of a CSV file with the postures of a chain in which a change is unsafe."""
    names, joints = [node.name for node in controlled.nodes], len(controlled.chain.lower)
    yield ",".join(["from", "to", *(f"angle_{j + 1}_deg" for j in range(joints)), "missing_Nm,controller_changes_here"])
    for one in controlled.changes:
        for k in np.flatnonzero(one.unsafe):
            angles = ",".join(f"{angle:.2f}" for angle in np.degrees(one.q[k]))
            change = f"{names[one.before]},{names[one.after]}"
            yield f"{change},{angles},{one.missing[k]:.4f},{str(bool(one.switched[k])).lower()}"


def controller_lines(controlled: ControlledTasks | ControlledChain) -> Iterator[str]:
    """Yield sentences about nodes, tour and problems of a controller."""
    if isinstance(controlled, ControlledChain):
        yield from _chain_node_lines(controlled)
        held, duration = [one <= controlled.tolerance for one in controlled.missing], controlled.tour.time[-1]
    else:
        yield from _joint_node_lines(controlled)
        held, duration = [visit.held for visit in controlled.visits], controlled.motion.tour.time[-1]
    yield (
        f"tour of {duration:.0f} s: {sum(held)} of {len(held)} visits held, {len(controlled.switches)} changes, "
        f"{1e3 * sum(controlled.gas):.2f} g of gas"
    )
    yield from (f"problem: {problem}" for problem in controlled.problems)


def _joint_node_lines(controlled: ControlledTasks) -> Iterator[str]:
    for node in controlled.controller.nodes:
        pressures = " and ".join(f"{1e-5 * pressure:.2f} bar" for pressure in node.setting.pressures())
        intervals = _intervals(controlled.controller.angle, node.depth > 0)
        held = ", ".join(f"{low:.1f}° to {high:.1f}°" for low, high in intervals)
        yield f"node {node.name}: {pressures} hold {held}"


def _chain_node_lines(controlled: ControlledChain) -> Iterator[str]:
    for node, share in zip(controlled.nodes, controlled.held, strict=True):
        pressures = "; ".join(
            f"joint {' and '.join(str(joint + 1) for joint in one.joints)} {pair[0]:.2f} bar and {pair[1]:.2f} bar"
            for one, pair in zip(controlled.chain.actuators, 1e-5 * node.pressures, strict=True)
        )
        yield f"node {node.name}: {pressures} hold {100 * share:.0f} % of the postures"
