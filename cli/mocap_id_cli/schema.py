"""``mocap-id schema``: JSON Schemas of the configuration files."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from mocap_id.config import build_schema
from mocap_id.config.parsing import build_json_schema
from mocap_id.config.study import build_study_schema
from mocap_id.stages.device import DeviceFile
from mocap_id_assist.files import PrescriptionFile


def schema(
    study: Annotated[bool, typer.Option("--study", help="Print the schema of a study's file.")] = False,
    prescription: Annotated[
        bool, typer.Option("--prescription", help="Print the schema of a prescription's file.")
    ] = False,
    device: Annotated[bool, typer.Option("--device", help="Print the schema of a pneumatic device's file.")] = False,
) -> None:
    """Print the JSON Schema of a trial's YAML file, for editors."""
    if device:
        document = build_json_schema(DeviceFile)
    elif prescription:
        document = build_json_schema(PrescriptionFile)
    else:
        document = build_study_schema() if study else build_schema()
    typer.echo(json.dumps(document, indent=2, ensure_ascii=False))
