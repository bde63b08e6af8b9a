"""``mocap-id schema``: JSON Schemas of the configuration files."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from mocap_id.config import schema as trial_schema
from mocap_id.config.prescription import prescription_schema
from mocap_id.config.study import study_schema


def schema(
    study: Annotated[bool, typer.Option("--study", help="Print the schema of a study's file.")] = False,
    prescription: Annotated[
        bool, typer.Option("--prescription", help="Print the schema of a prescription's file.")
    ] = False,
) -> None:
    """Print the JSON Schema of a trial's YAML file, for editors."""
    found = prescription_schema() if prescription else study_schema() if study else trial_schema()
    typer.echo(json.dumps(found, indent=2, ensure_ascii=False))
