"""Controllers of a joint and of a chain as JSON and as lines of text, and their unsafe states as CSV."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.pneumatics import chain_tour, switching
from mocap_id.pneumatics.switching import TransitionMap
from mocap_id.reporting.results.columns import to_finite
from mocap_id.workflows.prescribe.controlled_chain import ChainChange, ControlledChain
from mocap_id.workflows.prescribe.controlled_tasks import ControlledTasks


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
    steps = _change_rows(controlled, switching.STEP, names, lambda k: {"angle_deg": float(np.degrees(motion.angle[k]))})
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
            "start_s": start * chain_tour.STEP,
            "at_deg": np.degrees(tour.q[start]).tolist(),
            "held": missing <= controlled.tolerance,
            "missing_Nm": missing,
        }
        for (stop, start, _), missing in zip(tour.visits, controlled.missing, strict=True)
    ]
    steps = _change_rows(controlled, chain_tour.STEP, names, lambda k: {"at_deg": np.degrees(tour.q[k]).tolist()})
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
