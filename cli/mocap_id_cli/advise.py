"""``mocap-id advise``: the movement to record next."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from mocap_id.design.proposal import Objective
from mocap_id.workflows import advice
from mocap_id.workflows.run_folder import describe_sources
from mocap_id_cli import progress
from mocap_id_cli.console import AsJson, Quiet, TrialPath, Verbose, log_to_stderr, print_result


def advise(
    trial: TrialPath,
    *,
    objective: Annotated[
        Objective,
        typer.Option(
            "--for", help="What to minimise: standard deviations, the volume of their ellipsoid, or a condition number."
        ),
    ] = "intervals",
    seconds: Annotated[float | None, typer.Option(help="Length of the recording, s; default: as in TRIAL.")] = None,
    widen: Annotated[
        float | None,
        typer.Option(
            help="Angle by which the observed range of each joint may be exceeded, degrees; default: 20 for a robot, "
            "otherwise 5."
        ),
    ] = None,
    angle: Annotated[
        list[str] | None, typer.Option(metavar="JOINT=LOW:HIGH", help="Range of one joint, degrees (repeatable).")
    ] = None,
    speed: Annotated[float | None, typer.Option(help="Speed limit of every joint, degrees/s.")] = None,
    acceleration: Annotated[float | None, typer.Option(help="Acceleration limit of every joint, degrees/s^2.")] = None,
    support: Annotated[
        str | None,
        typer.Option(metavar="LOW:HIGH", help="Range of the centre of pressure, cm, or `bolted` for no limit."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the search.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder for advice.json, movement.csv and movement.svg.")
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Propose the movement to record next.

    This movement would determine the parameters of the body best. If TRIAL is a YAML file, missing or outdated results
    are computed first; a run folder is read unchanged.
    """
    log_to_stderr(quiet, verbose)
    options = advice.AdviceOptions(
        objective=objective,
        seconds=seconds,
        widen=widen,
        angles=dict(advice.parse_angle_range(each) for each in angle or ()),
        speed=speed,
        acceleration=acceleration,
        support=None if support is None else advice.parse_support(support),
        seed=seed,
    )
    found = advice.advise(trial, options, progress.report_stages(quiet))
    output = advice.make_output(found)
    if out is not None:
        output = replace(output, made_from=describe_sources(out, trial))
        output.write(out)
    print_result(as_json, output.document, advice.format_text(found))
