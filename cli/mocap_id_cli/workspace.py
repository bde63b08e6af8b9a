"""``mocap-id workspace``: the workspace of the tip of a recovered chain."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from typer import Argument, Option

from mocap_id.workflows.run_folder import write_result
from mocap_id_assist import workspaces as workflow
from mocap_id_assist.workspace import ReachableWorkspace
from mocap_id_cli.console import Output, common_options


@common_options
def workspace(
    trial: Annotated[
        Path, Argument(metavar="TRIAL", help="A trial's YAML file or run folder, or a chain's YAML file.")
    ],
    *,
    compare: Annotated[Path | None, Option(metavar="TRIAL", help="A later session to compare with the first.")] = None,
    tip: Annotated[
        str | None,
        Option(
            metavar="MARKER", help="Marker of the last segment, or x,y in its frame, m.", show_default="farthest marker"
        ),
    ] = None,
    quantile: Annotated[
        float, Option(help="Fraction of samples that is excluded at each end of an angle's range.")
    ] = 0.0,
    samples: Annotated[int, Option(help="Number of postures to sample.")] = 10_000,
    seed: Annotated[int, Option(help="Seed of the samples.")] = 0,
    out: Annotated[Path | None, Option(metavar="FOLDER", help="Folder for JSON, CSV and figures.")] = None,
    output: Output,
) -> None:
    """Compute what the tip of a chain reaches within its limits.

    The result is an area (in space a volume) for the observed limits of the joints. Forces are not needed. If TRIAL is
    a trial's YAML file, missing or outdated stages up to the joint states are computed first; a run folder is read
    unchanged.
    """
    paths = [trial] if compare is None else [trial, compare]
    subjects = [workflow.read_arm(path, tip, quantile, output.report_stage) for path in paths]
    reaches = [workflow.measure_workspace(subject, samples, seed) for subject in subjects]
    later = None
    if compare is not None:
        change = workflow.compare_workspaces(subjects[0], reaches[0], subjects[1], reaches[1])
        later = subjects[1], reaches[1], change
    result, written = write_result(workflow.workspace_result(subjects[0], reaches[0], later), out, *paths)
    lines = [line for each in zip(subjects, reaches, strict=True) for line in _lines(*each)]
    if compare is not None:
        unit = "m²" if change.points.shape[1] == 2 else "m³"
        lines.append(
            f"from the first to the second: gained {change.gained:.5f} {unit}, lost {change.lost:.5f}, kept "
            f"{change.kept:.5f}; both are aligned at the first joint"
        )
        lines += [f"  note: {each}" for each in result.content["change"]["notes"]]
    output.print_result(result.document, [*lines, *written])


def _lines(subject: workflow.SubjectArm, found: ReachableWorkspace) -> Iterator[str]:
    kind, unit = ("area", "m²") if subject.arm.dimension == 2 else ("volume", "m³")
    low, high = found.interval
    yield f"{subject.name}: {kind} {found.measure:.5f} {unit}, 95 % interval {low:.5f} to {high:.5f}; tip {subject.tip}"
    bounds = zip(subject.joints, *np.degrees([subject.limits.lower, subject.limits.upper]), strict=True)
    yield from (f"  {name}: {lower:.1f}° to {upper:.1f}°" for name, lower, upper in bounds)
    steps = ", ".join(f"{value:.5f} with {count}" for count, _, value in found.convergence)
    yield f"  samples: {steps}"
    yield from (f"  note: {note}" for note in subject.notes)
