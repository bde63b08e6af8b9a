"""Prescriptions as files: JSON for programs, tables as CSV, figures for people."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mocap_id import __version__
from mocap_id.prescription.several_springs import holds
from mocap_id.prescription.sub_workspaces import Graph
from mocap_id.reporting.paper import drawn
from mocap_id.reporting.reach import functional, heat, ranges, timed
from mocap_id.store.atomic import explained, replace_together
from mocap_id.workflows.prescribe.performing import Prescribed, Timed
from mocap_id.workflows.prescribe.searching import SpringMap
from mocap_id.workflows.workspace import as_json as workspace_json


def as_json(found: Prescribed) -> dict[str, Any]:
    """What was found; null with a `why` where nothing could be prescribed. Angles in degrees where the key says so."""
    body = found.body
    result: dict[str, Any] = {
        "schema": "mocap-id/prescription",
        "version": 1,
        "product": __version__,
        "prescription": found.config.wishes.prescription,
        "joints": [
            {
                "name": name,
                "limits_deg": _degrees((body.limits.lower[j], body.limits.upper[j])),
                "strength_Nm": [_number(value) for value in body.strength[j]],
            }
            for j, name in enumerate(body.joints)
        ],
        "why": found.refused,
        "springs": None,
    }
    if found.workspace is not None:
        result["workspace"] = workspace_json(found.workspace)
    if found.one is not None and found.joint is not None:
        result |= _one(found)
    if found.several is not None:
        result |= _several(found)
    if found.timed is not None:
        result["level_set"] = _timed(found.timed)
    if found.map is not None:
        result["search"] = _map(found.map)
    if found.graph is not None and found.graph_postures is not None:
        result["sub_workspaces"] = _graph(found.graph, found.graph_postures)
    return result


def write(folder: Path, found: Prescribed) -> tuple[str, ...]:
    """Write ``prescription.json`` and what tables and figures there are; the names of the files.

    Raises
    ------
    StoreError
        The folder cannot be written.
    """
    text = json.dumps(as_json(found), indent=1, ensure_ascii=False, allow_nan=False)
    contents: dict[str, bytes] = {"prescription.json": text.encode()}
    name = found.config.wishes.prescription
    one, joint, over, springs = found.one, found.joint, found.timed, found.map
    if one is not None and joint is not None:
        contents |= drawn("range", f"range with and without a spring: {name}", lambda: ranges.draw(joint, one))
    if found.postures is not None and found.several is not None:
        contents |= drawn("functional", f"what can be held: {name}", lambda: _held(found))
    if over is not None:
        contents |= drawn(
            "level_set",
            f"reachable set over time: {name}",
            lambda: timed.draw(over.reached, over.bounds, over.dynamics),
        )
        contents["horizons.csv"] = "\n".join([*_horizons(over), ""]).encode()
    if springs is not None:
        contents |= drawn(
            "search",
            f"springs by their reachable sets: {name}",
            lambda: heat.draw(springs.stiffness, springs.rest, springs.width, springs.horizon),
        )
        contents["search.csv"] = "\n".join([*_rows(springs), ""]).encode()
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    replace_together(folder, contents)
    return tuple(contents)


def _held(found: Prescribed) -> Figure:
    springs, sampled, strength = found.several, found.postures, found.body.strength
    assert springs is not None and sampled is not None
    none = holds(sampled, (), strength, springs)
    return functional.draw(
        sampled.tips, none, holds(sampled, found.places, strength, springs), found.body.arm.centres[0]
    )


def _one(found: Prescribed) -> dict[str, Any]:
    one, joint = found.one, found.joint
    assert one is not None and joint is not None
    spring = {"joints": [1], "stiffness_Nm_per_rad": one.stiffness, "rest_deg": _number(np.degrees(one.rest))}
    return {
        "helps": one.helps,
        "springs": [spring] if one.helps else [],
        "moment_of_gravity_Nm": joint.weight,
        "range_deg": _degrees(one.range),
        "range_without_deg": None if one.without is None else _degrees(one.without),
        "gap_deg": float(np.degrees(one.gap)),
    }


def _several(found: Prescribed) -> dict[str, Any]:
    springs = found.several
    assert springs is not None
    return {
        "helps": springs.helps,
        "springs": [
            {
                "joints": [joint + 1 for joint in place.joints],
                "stiffness_Nm_per_rad": float(springs.stiffness[s]),
                "rest_deg": _number(np.degrees(springs.rest[s])),
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


def _timed(over: Timed) -> dict[str, Any]:
    start = over.dynamics.equilibrium()
    return {
        "stiffness_Nm_per_rad": over.dynamics.stiffness,
        "rest_deg": _number(np.degrees(over.dynamics.rest)),
        "inertia_kgm2": over.dynamics.inertia,
        "equilibrium_deg": None if start is None else float(np.degrees(start)),
        "static_deg": None if over.static is None else _degrees(over.static),
        "horizons": [
            {"time_s": time, "reached_and_held_deg": None if bound is None else _degrees(bound)}
            for time, bound in zip(over.reached.times, over.bounds, strict=True)
        ],
    }


def _map(springs: SpringMap) -> dict[str, Any]:
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
    ways = {(a, b): graph.way(a, b) for a in count for b in count if a < b}
    return {
        "nodes": [
            {
                "name": node.name,
                "tasks": list(node.tasks),
                "springs": None
                if node.stiffness is None or node.rest is None
                else [
                    {"stiffness_Nm_per_rad": float(k), "rest_deg": _number(np.degrees(rest))}
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


def _horizons(over: Timed) -> Iterator[str]:
    yield "time_s,lower_deg,upper_deg"
    for time, bound in zip(over.reached.times, over.bounds, strict=True):
        yield ",".join([f"{time:g}", *("" if bound is None else f"{np.degrees(end):.3f}" for end in bound or (0, 0))])


def _rows(springs: SpringMap) -> Iterator[str]:
    yield "stiffness_Nm_per_rad,rest_deg,reached_and_held_deg,held_deg"
    for k, stiffness in enumerate(springs.stiffness):
        for r, rest in enumerate(np.degrees(springs.rest)):
            width, static = np.degrees([springs.width[k, r], springs.static[k, r]])
            reached = "" if np.isnan(width) else f"{width:.3f}"
            yield f"{stiffness:.6g},{rest:.6g},{reached},{static:.3f}"


def _degrees(pair: tuple[float, float]) -> list[float]:
    return [float(np.degrees(pair[0])), float(np.degrees(pair[1]))]


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
