"""``mocap-id stages``: list of the stages, their settings, and Makefile rules."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mocap_id.config import load
from mocap_id.runner import make_rules
from mocap_id.stages import STAGES
from mocap_id_cli.settings import format_settings_yaml


def stages(
    make: Annotated[
        list[Path] | None,
        typer.Option("--make", metavar="TRIAL.yaml", help="Print Makefile rules for this trial (repeatable)."),
    ] = None,
    settings: Annotated[
        bool, typer.Option("--settings", help="Print all settings as YAML comments, to copy into a trial's file.")
    ] = False,
) -> None:
    """List the stages in order, with their inputs and outputs."""
    if make:
        typer.echo("MOCAP_ID ?= mocap-id")
        typer.echo(make_rules([load(file) for file in make], "$(MOCAP_ID)"), nl=False)
    elif settings:
        typer.echo(format_settings_yaml(), nl=False)
    else:
        for stage in STAGES:
            typer.echo(f"{stage.name}: {stage.help}")
            typer.echo(f"    reads   {', '.join(stage.inputs) or 'the recording'}")
            typer.echo(f"    writes  {', '.join(stage.outputs)}")
