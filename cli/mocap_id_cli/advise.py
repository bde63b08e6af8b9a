"""``mocap-id advise``: the movement to record next."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mocap_id.design.proposal import Objective
from mocap_id.workflows import advice
from mocap_id_cli import progress
from mocap_id_cli.console import AsJson, Quiet, TrialPath, Verbose, log_to_stderr, print_result


def advise(
    trial: TrialPath,
    *,
    objective: Annotated[
        Objective,
        typer.Option("--for", help="What to minimise: standard deviations, their volume, or a condition number."),
    ] = "intervals",
    seconds: Annotated[float | None, typer.Option(help="Length of the recording, s; default: as this trial.")] = None,
    widen: Annotated[
        float | None,
        typer.Option(help="Degrees beyond the observed range of each joint; default: 20 for a robot, else 5."),
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
        Path | None, typer.Option(metavar="FOLDER", help="Write advice.json, movement.csv and movement.svg.")
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Propose the movement to record next.

    This movement would determine the parameters of the body best. With a YAML file, missing or
    outdated results are computed first; a run folder is read unchanged.
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
        output.write(out)
    print_result(as_json, output.document, advice.format_text(found))
