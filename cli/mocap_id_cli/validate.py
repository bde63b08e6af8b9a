"""``mocap-id validate``: the validation studies of the thesis, on simulated trials or on your own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from mocap_id_cli.console import Jobs, Output, common_options, make_group, shorten
from mocap_id_simulation import RobotSet
from mocap_id_simulation.space_robot import reuse_robot_set

if TYPE_CHECKING:
    from mocap_id.workflows.study.robots import RobotStudyResult


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
    from mocap_id.workflows.study import robots  # noqa: PLC0415  no other command has to wait for it

    simulated = RobotSet(repeats, options=replace(RobotSet().options, seed=seed))
    result = robots.validate_robot(
        trials or partial(reuse_robot_set, robot_set=simulated),
        out,
        jobs=jobs,
        tell=output.report_trial,
        page=page,
    )
    output.print_result(result.document, _lines(result))
    if result.failed:
        raise typer.Exit(1)


def _lines(result: RobotStudyResult) -> Iterator[str]:
    for run in result.failed:
        yield f"{run.trial}: {run.message}"
    yield f"{len(result.trials) - len(result.failed)} of {len(result.trials)} trials have results"
    yield f"tables: {shorten(result.folder)}"
    yield f"page: {shorten(result.page)}"


validate = make_group("Repeat the validation studies of the thesis.", robot=_robot)
