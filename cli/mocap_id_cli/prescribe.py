"""``mocap-id prescribe``: springs that restore as much of a range of motion as possible."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from mocap_id.errors import Refused
from mocap_id.workflows.run_folder import describe_sources
from mocap_id_assist.files import load_prescription
from mocap_id_assist.prescription_output import prescription_lines, prescription_output
from mocap_id_assist.prescriptions import prescribe_from
from mocap_id_cli import progress
from mocap_id_cli.console import AsJson, Quiet, Verbose, log_to_stderr, print_json


def prescribe(
    config: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG.yaml", help="The prescription's configuration (docs/prescribe.md).", show_default=False
        ),
    ],
    *,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder for JSON, tables and figures; with the same folder, an interrupted search is continued.",
            show_default=False,
        ),
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Find springs that let a weak person hold a wider range.

    The range is that of one joint or of a whole chain.
    """
    log_to_stderr(quiet, verbose)

    def tell(line: str) -> None:
        if not quiet:
            typer.echo(line, err=True)

    found = prescribe_from(load_prescription(config), out, progress.report_stages(quiet), tell)
    output = prescription_output(found)
    if out is not None:
        output = replace(output, made_from=describe_sources(out, config))
    files = () if out is None else output.write(out)
    if as_json:
        print_json(output.document)
    else:
        typer.echo("\n".join(prescription_lines(found)))
        if files:
            typer.echo(f"written to {out}: {', '.join(files)}")
    if found.refused is not None:
        raise typer.Exit(Refused.exit_code)
