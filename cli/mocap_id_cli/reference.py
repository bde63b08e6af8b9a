"""The program about itself: its configuration's schema, its stages, their settings, their Makefile rules."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from mocap_id.config import load
from mocap_id.config import schema as trial_schema
from mocap_id.config.prescription import prescription_schema
from mocap_id.config.study import study_schema
from mocap_id.runner import make_rules
from mocap_id.stages import STAGES
from mocap_id_cli.settings import settings_yaml


def schema(
    study: Annotated[bool, typer.Option("--study", help="Of a study's file instead.")] = False,
    prescription: Annotated[bool, typer.Option("--prescription", help="Of a prescription's file instead.")] = False,
) -> None:
    """Print the JSON Schema of a trial's YAML file, for editors."""
    found = prescription_schema() if prescription else study_schema() if study else trial_schema()
    typer.echo(json.dumps(found, indent=2, ensure_ascii=False))


def stages(
    make: Annotated[
        list[Path] | None,
        typer.Option("--make", metavar="TRIAL.yaml", help="Print Makefile rules for this trial (repeatable)."),
    ] = None,
    settings: Annotated[
        bool, typer.Option("--settings", help="Print every stage's settings, commented out, to copy into a trial.")
    ] = False,
) -> None:
    """Print the stages in their order: what each reads and writes."""
    if make:
        typer.echo(make_rules([load(file) for file in make], "$(MOCAP_ID)"), nl=False)
    elif settings:
        typer.echo(settings_yaml(), nl=False)
    else:
        for stage in STAGES:
            typer.echo(f"{stage.name}: {stage.help}")
            typer.echo(f"    reads   {', '.join(stage.inputs) or 'the recording'}")
            typer.echo(f"    writes  {', '.join(stage.outputs)}")
