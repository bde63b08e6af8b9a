"""``mocap-id advise``: the movement to record next."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from mocap_id.design.proposal import Objective
from mocap_id.workflows import advice
from mocap_id.workflows.run_folder import write_result
from mocap_id_cli.console import Output, TrialPath, common_options


@common_options
def advise(
    trial: TrialPath,
    *,
    objective: Annotated[
        Objective,
        Option(
            "--for", help="What to minimise: standard deviations, the volume of their ellipsoid, or a condition number."
        ),
    ] = "intervals",
    seconds: Annotated[float | None, Option(help="Length of the recording, s; default: as in TRIAL.")] = None,
    widen: Annotated[
        float | None,
        Option(
            help="Angle by which the observed range of each joint may be exceeded, degrees; default: 20 for a robot, "
            "otherwise 5."
        ),
    ] = None,
    angle: Annotated[
        list[str] | None, Option(metavar="JOINT=LOW:HIGH", help="Range of one joint, degrees (repeatable).")
    ] = None,
    speed: Annotated[float | None, Option(help="Speed limit of every joint, degrees/s.")] = None,
    acceleration: Annotated[float | None, Option(help="Acceleration limit of every joint, degrees/s^2.")] = None,
    support: Annotated[
        str | None, Option(metavar="LOW:HIGH", help="Range of the centre of pressure, cm, or `bolted` for no limit.")
    ] = None,
    seed: Annotated[int, Option(help="Seed of the search.")] = 0,
    out: Annotated[
        Path | None, Option(metavar="FOLDER", help="Folder for advice.json, movement.csv and movement.svg.")
    ] = None,
    output: Output,
) -> None:
    """Propose the movement to record next.

    This movement would determine the parameters of the body best. If TRIAL is a YAML file, missing or outdated results
    are computed first; a run folder is read unchanged.
    """
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
    found = advice.advise_movement(trial, options, output.report_stage)
    result, _ = write_result(advice.make_output(found), out, trial)
    output.print_result(result.document, advice.format_text(found))
