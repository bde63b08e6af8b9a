"""``mocap-id validate``: the thesis's validation studies, on simulated trials or on a laboratory's own."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocap_id.simulation import RobotSet
from mocap_id_cli.run import Quiet, Verbose, log_to_stderr, short
from mocap_id_cli.telling import teller

if TYPE_CHECKING:
    from mocap_id.workflows.robot_study import Outcome


def validating() -> typer.Typer:
    """The commands of ``mocap-id validate``."""
    app = typer.Typer(
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        help="Repeat the thesis's validation studies.",
    )
    app.callback()(_studies)
    app.command("robot")(robot)
    return app


def _studies() -> None:
    """Repeat the thesis's validation studies."""


def robot(
    trials: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[STUDY|TRIAL...]",
            help="A robot study's file, or trials' files; with none, the set in FOLDER/trials, simulated if need be.",
            show_default=False,
        ),
    ] = None,
    *,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Where everything goes.")] = Path("validation-robot"),
    repeats: Annotated[int, typer.Option(help="Simulated trials of each cell.")] = RobotSet.repeats,
    seed: Annotated[int, typer.Option(help="Of the simulated trials.")] = 1,
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Trials at a time.")] = 1,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Markdown page whose tables are replaced.", show_default=False)
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print validation.json.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Repeat tables 5.1 to 5.6 and figures 5.2 to 5.6 of the thesis, on simulated trials or on one's own.

    Every trial goes through every method for the joint states. One that fails stops no other; the exit code is then 1.
    """
    from mocap_id.workflows import robot_study as workflow  # noqa: PLC0415  no other command has to wait for it

    log_to_stderr(quiet, verbose)
    options = replace(RobotSet().options, seed=seed)
    found = workflow.validate_robot(
        trials or [],
        out,
        generated=RobotSet(repeats, options=options),
        jobs=jobs,
        tell=teller(quiet),
        page=page,
    )
    if as_json:
        typer.echo(json.dumps(found.document, indent=2, ensure_ascii=False, allow_nan=False))
    else:
        typer.echo("\n".join(_lines(found)))
    if found.failed:
        raise typer.Exit(1)


def _lines(found: Outcome) -> Iterator[str]:
    for done in found.failed:
        yield f"{done.trial}: {done.message}"
    yield f"{len(found.cases) - len(found.failed)} of {len(found.cases)} trials went through"
    yield f"tables: {short(found.folder)}"
    yield f"page: {short(found.page)}"
