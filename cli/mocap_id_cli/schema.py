"""``mocap-id schema``: JSON Schemas of the configuration files."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from mocap_id.config import schema as trial_schema
from mocap_id.config.device import device_schema
from mocap_id.config.prescription import prescription_schema
from mocap_id.config.study import study_schema


def schema(
    study: Annotated[bool, typer.Option("--study", help="Print the schema of a study's file.")] = False,
    prescription: Annotated[
        bool, typer.Option("--prescription", help="Print the schema of a prescription's file.")
    ] = False,
    device: Annotated[bool, typer.Option("--device", help="Print the schema of a pneumatic device's file.")] = False,
) -> None:
    """Print the JSON Schema of a trial's YAML file, for editors."""
    kinds = ((device, device_schema), (prescription, prescription_schema), (study, study_schema))
    found = next((make for wanted, make in kinds if wanted), trial_schema)()
    typer.echo(json.dumps(found, indent=2, ensure_ascii=False))
