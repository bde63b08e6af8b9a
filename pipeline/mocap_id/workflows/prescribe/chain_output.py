"""The controller of a chain as JSON, as lines of text, and its unsafe postures as CSV."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mocap_id.pneumatics.chain_tour import STEP
from mocap_id.workflows.prescribe.controlled_chain import ChainChange, ControlledChain


def chain_document(found: ControlledChain) -> dict[str, Any]:
    """Return nodes, changes, tour and problems of the controller of a chain."""
    tour, names = found.tour, [node.name for node in found.nodes]
    return {
        "nodes": [
            {
                "name": node.name,
                "devices": [
                    {"joints": [joint + 1 for joint in one.joints], "flexion_Pa": gas[0], "extension_Pa": gas[1]}
                    for one, gas in zip(found.chain.actuators, node.pressures.tolist(), strict=True)
                ],
                "reserve_share": margin,
                "held_share": float(share),
            }
            for node, margin, share in zip(found.nodes, found.margins, found.held, strict=True)
        ],
        "changes": [_change(one, names) for one in found.changes],
        "tour": {
            "duration_s": float(tour.time[-1]),
            "tasks": [
                {
                    "task": found.stops[stop],
                    "start_s": start * STEP,
                    "at_deg": np.degrees(tour.q[start]).tolist(),
                    "held": missing <= found.tolerance,
                    "missing_Nm": missing,
                }
                for (stop, start, _), missing in zip(tour.visits, found.missing, strict=True)
            ],
            "changes": [
                {
                    "time_s": k * STEP,
                    "from": names[before],
                    "to": names[after],
                    "at_deg": np.degrees(tour.q[k]).tolist(),
                    "gas_g": 1e3 * gas,
                }
                for (k, before, after), gas in zip(tour.switches, found.gas, strict=True)
            ],
            "missing_Nm": float(tour.excess.max()),
            "gas_g": 1e3 * sum(found.gas),
            "shortest_dwell_s": found.shortest_dwell if np.isfinite(found.shortest_dwell) else None,
            "settling_s": found.settling,
        },
        "problems": list(found.problems),
    }


def _change(one: ChainChange, names: Sequence[str]) -> dict[str, Any]:
    return {
        "from": names[one.before],
        "to": names[one.after],
        "postures": len(one.q),
        "unsafe_share": float(one.unsafe[one.switched].mean()) if one.switched.any() else None,
        "unsafe_share_of_overlap": float(one.unsafe.mean()),
    }


def unsafe_postures(found: ControlledChain) -> Iterator[str]:
    """Yield the postures in which a change is unsafe as lines of a CSV file."""
    names, joints = [node.name for node in found.nodes], len(found.chain.lower)
    yield ",".join(["from", "to", *(f"angle_{j + 1}_deg" for j in range(joints)), "missing_Nm,controller_changes_here"])
    for one in found.changes:
        for k in np.flatnonzero(one.unsafe):
            angles = ",".join(f"{angle:.2f}" for angle in np.degrees(one.q[k]))
            way = f"{names[one.before]},{names[one.after]}"
            yield f"{way},{angles},{one.missing[k]:.4f},{str(bool(one.switched[k])).lower()}"


def chain_lines(found: ControlledChain) -> Iterator[str]:
    """Yield sentences about the controller of a chain."""
    for node, share in zip(found.nodes, found.held, strict=True):
        gas = "; ".join(
            f"joint {' and '.join(str(joint + 1) for joint in one.joints)} {pair[0]:.2f} bar and {pair[1]:.2f} bar"
            for one, pair in zip(found.chain.actuators, 1e-5 * node.pressures, strict=True)
        )
        yield f"node {node.name}: {gas} hold {100 * share:.0f} % of the postures"
    tour = found.tour
    held = sum(one <= found.tolerance for one in found.missing)
    yield (
        f"tour of {tour.time[-1]:.0f} s: {held} of {len(found.missing)} visits held, {len(tour.switches)} changes, "
        f"{1e3 * sum(found.gas):.2f} g of gas"
    )
    yield from (f"problem: {problem}" for problem in found.problems)
