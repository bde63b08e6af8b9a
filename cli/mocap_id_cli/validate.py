"""``mocap-id validate``: the validation studies of the thesis, on simulated trials or on your own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocap_id_cli import progress
from mocap_id_cli.console import AsJson, Jobs, Quiet, Verbose, log_to_stderr, make_group, print_result, shorten
from mocap_id_simulation import RobotSet
from mocap_id_simulation.robot_set import reuse_robot_set

if TYPE_CHECKING:
    from mocap_id.workflows.study.robots import RobotStudyResult


def commands() -> typer.Typer:
    """Return the commands of ``mocap-id validate``."""
    return make_group("Repeat the validation studies of the thesis.", robot=_robot)


def _robot(
    trials: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[STUDY|TRIAL...]",
            help="A robot study's file, or trial files; default: the trials in FOLDER/trials, simulated if missing.",
            show_default=False,
        ),
    ] = None,
    *,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Output folder.")] = Path("validation-robot"),
    repeats: Annotated[
        int, typer.Option(help="Simulated trials of each joint, speed and orientation.")
    ] = RobotSet.repeats,
    seed: Annotated[int, typer.Option(help="Seed of the simulated trials.")] = 1,
    jobs: Jobs = 1,
    page: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Markdown page in which to replace the tables.", show_default=False),
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Repeat tables 5.1 to 5.6 and figures 5.2 to 5.6 of the thesis, on simulated trials or on your own.

    Every method for the joint states is applied to every trial. If a trial fails, the other trials still run, and the
    exit code is 1.
    """
    from mocap_id.workflows.study import robots as workflow  # noqa: PLC0415  no other command has to wait for it

    log_to_stderr(quiet, verbose)
    simulated = RobotSet(repeats, options=replace(RobotSet().options, seed=seed))
    result = workflow.validate_robot(
        trials or partial(reuse_robot_set, robot_set=simulated),
        out,
        jobs=jobs,
        tell=progress.report_trials(quiet),
        page=page,
    )
    print_result(as_json, result.document, _lines(result))
    if result.failed:
        raise typer.Exit(1)


def _lines(result: RobotStudyResult) -> Iterator[str]:
    for run in result.failed:
        yield f"{run.trial}: {run.message}"
    yield f"{len(result.trials) - len(result.failed)} of {len(result.trials)} trials have results"
    yield f"tables: {shorten(result.folder)}"
    yield f"page: {shorten(result.page)}"
