"""``mocap-id advise``: which movement to record next."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from mocap_id.dynamics.proposal import Objective
from mocap_id.workflows import advice
from mocap_id_cli.run import Quiet, Verbose, log_to_stderr, progress


def advise(
    trial: Annotated[
        Path, typer.Argument(metavar="TRIAL", help="Trial to start from: YAML or run folder.", show_default=False)
    ],
    *,
    objective: Annotated[
        Objective, typer.Option("--for", help="What is to become small: sds, their volume, or a condition number.")
    ] = "intervals",
    seconds: Annotated[float | None, typer.Option(help="Length of the recording, s; default: as the trial.")] = None,
    widen: Annotated[
        float | None, typer.Option(help="Degrees beyond what was seen of each joint; default: robot 20, else 5.")
    ] = None,
    angle: Annotated[
        list[str] | None, typer.Option(metavar="JOINT=LOW:HIGH", help="Range of one joint, degrees; repeat for more.")
    ] = None,
    speed: Annotated[float | None, typer.Option(help="Limit of every joint's speed, degrees/s.")] = None,
    acceleration: Annotated[float | None, typer.Option(help="Of its acceleration, degrees/s^2.")] = None,
    support: Annotated[
        str | None,
        typer.Option(metavar="LOW:HIGH", help="Where the centre of pressure may go, cm, or `bolted` for anywhere."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the search.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Write advice.json, movement.csv and movement.svg.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Tell which movement would make the parameters of a trial's body better known.

    What a YAML file asks for and is not there yet is computed first; a run folder is taken as it is.
    """
    log_to_stderr(quiet, verbose)
    asked = advice.Asked(
        objective=objective,
        seconds=seconds,
        widen=widen,
        angles=dict(advice.angle_range(each) for each in angle or ()),
        speed=speed,
        acceleration=acceleration,
        support=None if support is None else advice.support_range(support),
        seed=seed,
    )
    found = advice.advise(trial, asked, progress(quiet))
    if out is not None:
        advice.write(found, out)
    if as_json:
        typer.echo(json.dumps(advice.as_json(found), indent=2, ensure_ascii=False, allow_nan=False))
        return
    typer.echo("\n".join(advice.lines(found)))
