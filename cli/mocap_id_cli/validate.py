"""``mocap-id validate``: the validation studies of the thesis, on simulated trials or on your own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from mocap_id import workflows
from mocap_id.simulation import RobotSet
from mocap_id_cli.console import Jobs, Output, common_options, make_group, shorten


@common_options
def _robot(
    trials: Annotated[
        list[Path] | None,
        Argument(
            metavar="[STUDY|TRIAL...]",
            help="A robot study's file, or trial files; default: the trials in FOLDER/trials, simulated if missing.",
        ),
    ] = None,
    *,
    out: Annotated[Path, Option(metavar="FOLDER", help="Output folder.")] = Path("validation-robot"),
    repeats: Annotated[int, Option(help="Simulated trials of each joint, speed and orientation.")] = RobotSet.repeats,
    seed: Annotated[int, Option(help="Seed of the simulated trials.")] = 1,
    jobs: Jobs = 1,
    page: Annotated[Path | None, Option(metavar="FILE", help="Markdown page in which to replace the tables.")] = None,
    output: Output,
) -> None:
    """Repeat tables 5.1 to 5.6 and figures 5.2 to 5.6 of the thesis, on simulated trials or on your own.

    Every method for the joint states is applied to every trial. If a trial fails, the other trials still run, and the
    exit code is 1.
    """
    result = workflows.robot_study.validate_robot(
        trials or [],
        out,
        generated=RobotSet(repeats, options=replace(RobotSet().options, seed=seed)),
        jobs=jobs,
        tell=output.report_trial,
        page=page,
    )
    output.print_result(result.document, _lines(result))
    if result.failed:
        raise typer.Exit(1)


def _lines(result: workflows.robot_study.RobotStudyResult) -> Iterator[str]:
    for run in result.failed:
        yield f"{run.trial}: {run.message}"
    yield f"{len(result.trials) - len(result.failed)} of {len(result.trials)} trials have results"
    yield f"tables: {shorten(result.folder)}"
    yield f"page: {shorten(result.page)}"


validate = make_group("Repeat the validation studies of the thesis.", robot=_robot)
