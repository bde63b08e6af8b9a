"""``mocap-id validate``: the thesis's validation studies, on simulated trials or on your own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocap_id.simulation import RobotSet
from mocap_id_cli import progress
from mocap_id_cli.console import Quiet, Verbose, log_to_stderr, print_json, short

if TYPE_CHECKING:
    from mocap_id.workflows.robot_study import RobotStudyResult


def commands() -> typer.Typer:
    """Return the commands of ``mocap-id validate``."""
    app = typer.Typer(
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        help="Repeat the validation studies of the thesis.",
    )
    app.callback()(_studies)
    app.command("robot")(robot)
    return app


def _studies() -> None:
    """Repeat the validation studies of the thesis."""


def robot(
    trials: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[STUDY|TRIAL...]",
            help="A robot study's file, or trial files; default: the set in FOLDER/trials, simulated if missing.",
            show_default=False,
        ),
    ] = None,
    *,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Output folder.")] = Path("validation-robot"),
    repeats: Annotated[
        int, typer.Option(help="Simulated trials of each joint, speed and orientation.")
    ] = RobotSet.repeats,
    seed: Annotated[int, typer.Option(help="Seed of the simulated trials.")] = 1,
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Number of trials at a time.")] = 1,
    page: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Markdown page in which to replace the tables.", show_default=False),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print validation.json.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Repeat tables 5.1 to 5.6 and figures 5.2 to 5.6 of the thesis, on simulated trials or on your own.

    Every method for the joint states is applied to every trial. If a trial fails, the others still run and the exit
    code is 1.
    """
    from mocap_id.workflows import robot_study as workflow  # noqa: PLC0415  no other command has to wait for it

    log_to_stderr(quiet, verbose)
    options = replace(RobotSet().options, seed=seed)
    found = workflow.validate_robot(
        trials or [],
        out,
        generated=RobotSet(repeats, options=options),
        jobs=jobs,
        tell=progress.of_trials(quiet),
        page=page,
    )
    if as_json:
        print_json(found.document)
    else:
        typer.echo("\n".join(_lines(found)))
    if found.failed:
        raise typer.Exit(1)


def _lines(found: RobotStudyResult) -> Iterator[str]:
    for done in found.failed:
        yield f"{done.trial}: {done.message}"
    yield f"{len(found.trials) - len(found.failed)} of {len(found.trials)} trials went through"
    yield f"tables: {short(found.folder)}"
    yield f"page: {short(found.page)}"
