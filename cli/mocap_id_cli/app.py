"""The commands: ``run``, one for every stage of the tuple, and those that look at files and at the program itself."""

from __future__ import annotations

from typing import Annotated

import typer

from mocap_id import __version__
from mocap_id.stages import STAGES
from mocap_id_cli.advising import advise
from mocap_id_cli.initialising import init
from mocap_id_cli.inspecting import inspect
from mocap_id_cli.reference import schema, stages
from mocap_id_cli.running import run, stage_command
from mocap_id_cli.simulating import simulating
from mocap_id_cli.studying import study
from mocap_id_cli.transferring import transfer


def build() -> typer.Typer:
    """The command line, put together."""
    app = typer.Typer(
        name="mocap-id",
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
    )
    app.callback()(_top)
    app.command("run")(run)
    for stage in STAGES:
        app.command(stage.name, help=stage.help)(stage_command(stage))
    app.command("transfer")(transfer)
    app.command("advise")(advise)
    app.command("init")(init)
    app.command("study")(study)
    app.command("inspect")(inspect)
    app.add_typer(simulating(), name="simulate")
    app.command("schema")(schema)
    app.command("stages")(stages)
    return app


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"mocap-id {__version__}")
        raise typer.Exit


def _top(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Skeleton, joint states and inertial parameters of an individual from one motion-capture recording."""
