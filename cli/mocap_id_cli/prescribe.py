"""``mocap-id prescribe``: springs that restore as much of a range of motion as possible."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from typer import Argument, Option

from mocap_id.config.prescription import load_prescription
from mocap_id.errors import Refused
from mocap_id.workflows import prescribe as workflow
from mocap_id.workflows.run_folder import describe_sources
from mocap_id_cli.console import Output, common_options


@common_options
def prescribe(
    config: Annotated[
        Path, Argument(metavar="CONFIG.yaml", help="The prescription's configuration (docs/prescribe.md).")
    ],
    *,
    out: Annotated[
        Path | None,
        Option(
            metavar="FOLDER",
            help="Folder for JSON, tables and figures; with the same folder, an interrupted search is continued.",
        ),
    ] = None,
    output: Output,
) -> None:
    """Find springs that let a weak person hold a wider range.

    The range is that of one joint or of a whole chain.
    """
    found = workflow.prescribe_from(load_prescription(config), out, output.report_stage, output.say)
    result = workflow.prescription_output(found)
    if out is not None:
        result = replace(result, made_from=describe_sources(out, config))
    files = () if out is None else result.write(out)
    written = [f"written to {out}: {', '.join(files)}"] if files else []
    output.print_result(result.document, chain(_lines(found), written))
    if found.refused is not None:
        raise typer.Exit(Refused.exit_code)


def _lines(found: workflow.PrescriptionResult) -> Iterator[str]:
    name = found.config.wishes.prescription
    if found.workspace is not None:
        low, high = found.workspace.workspace.interval
        area = found.workspace.workspace.measure
        yield f"{name}: joint limits alone allow {area:.5f} m² (95 % interval {low:.5f} to {high:.5f})"
    if found.refused is not None:
        yield f"{name}: nothing can be prescribed: {found.refused}. Only the kinematic workspace is known"
        return
    if (one := found.one) is not None:
        joint = found.joint
        assert joint is not None
        without = "nothing" if one.without is None else _range(one.without)
        yield f"{name}: without a spring {without} can be held; gravity needs up to {joint.weight:.3f} N·m"
        if one.helps:
            share = one.stiffness / joint.weight
            yield (
                f"spring: {one.stiffness:.4g} N·m/rad ({share:.4f} of the moment of gravity per radian), rest angle "
                f"{math.degrees(one.rest):.1f}°: {_range(one.range)} can be held"
            )
            yield f"no other spring widens the range by more than another {math.degrees(one.gap):.2f}°"
        else:
            yield f"no spring helps: no spring widens the range by {math.degrees(one.gap):.1f}° or more"
    if (springs := found.several) is not None:
        yield (
            f"{name}: without springs {springs.without:.4f} m² of {springs.reachable:.4f} m² within reach can be held, "
            f"with them {springs.area:.4f} m²"
        )
        if not springs.helps:
            yield "no springs help"
        for s, place in enumerate(found.places):
            if springs.stiffness[s] > 0:
                across = " and ".join(found.body.joints[number] for number in place.joints)
                rest = math.degrees(springs.rest[s])
                yield f"spring on {across}: {springs.stiffness[s]:.4g} N·m/rad, rest {rest:.1f}°"
        yield f"no other springs hold over {springs.gap:.4f} m² more of these samples ({springs.boxes} boxes searched)"
    if (timed := found.timed) is not None:
        for time, bound, error in zip(timed.reached.times, timed.bounds, timed.grid_errors, strict=True):
            reached = "nothing" if bound is None else _range(bound)
            of_grid = "" if error is None else f"; half as many grid nodes change this by {math.degrees(error):.1f}°"
            yield f"within {time:g} s: {reached} reached and held{of_grid}"
        yield f"ever: {'nothing' if timed.static is None else _range(timed.static)} held"
        for gap in timed.unheld:
            yield f"{_range(gap)} can be passed, but not held: the person is too weak for this spring there"
    if (searched := found.map) is not None:
        if searched.best is None:
            yield "search: the joint does not rest within its limits with any of these springs"
        else:
            k, r = searched.best
            yield (
                f"search: widest within {searched.horizon:g} s is {math.degrees(searched.width[k, r]):.1f}°, with "
                f"{searched.stiffness[k]:.4g} N·m/rad and rest angle {math.degrees(searched.rest[r]):.0f}°"
            )
    if (graph := found.graph) is not None and (postures := found.graph_postures) is not None:
        for node in graph.nodes:
            text = "no suitable spring was found"
            if node.stiffness is not None and node.rest is not None:
                pairs = zip(node.stiffness, node.rest, strict=True)
                needed = [f"{k:.4g} N·m/rad at {math.degrees(rest):.1f}°" for k, rest in pairs if k > 0]
                text = ", ".join(needed) or "no spring is needed"
            yield f"sub-workspace {node.name} ({', '.join(node.tasks)}): {text}"
        for switch in graph.switches:
            first, second = (graph.nodes[k].name for k in switch.between)
            at = ", ".join(f"{angle:.0f}°" for angle in np.degrees(postures[switch.posture]))
            yield f"switch between {first} and {second} at {at}; overlap {100 * switch.share:.0f} % of the postures"
    yield from workflow.device_lines(found)


def _range(pair: tuple[float, float]) -> str:
    return f"{math.degrees(pair[0]):.1f}° to {math.degrees(pair[1]):.1f}°"
