"""The files of a prescription: a JSON document, tables as CSV, and figures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mocap_id import __version__
from mocap_id.prescription.several_springs import find_holdable
from mocap_id.prescription.sub_workspaces import Graph
from mocap_id.reporting.paper_figures import render
from mocap_id.reporting.pneumatic_figures import draw_chain_tour, draw_switching
from mocap_id.reporting.prescription_figures import (
    draw_holdable_postures,
    draw_level_sets,
    draw_ranges,
    draw_spring_map,
)
from mocap_id.reporting.results.columns import to_finite
from mocap_id.reporting.results.result import Result, make_text_file
from mocap_id.workflows.prescribe.controlled_chain import ControlledChain
from mocap_id.workflows.prescribe.controlled_tasks import ControlledTasks
from mocap_id.workflows.prescribe.controller_output import controller_document, unsafe_postures, unsafe_states
from mocap_id.workflows.prescribe.device_output import devices_document
from mocap_id.workflows.prescribe.result import PrescriptionResult, Timed
from mocap_id.workflows.prescribe.spring_map import SpringMap
from mocap_id.workflows.workspace import workspace_result


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
    none = find_holdable(sampled, (), strength, springs)
    return draw_holdable_postures(
        sampled.tips, none, find_holdable(sampled, found.places, strength, springs), found.body.arm.centres[0]
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
