"""``mocap-id prescribe``: springs that restore as much of a range of motion as possible."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from mocap_id.errors import Refused
from mocap_id.workflows.run_folder import write_result
from mocap_id_assist.files import load_prescription
from mocap_id_assist.prescription_output import prescription_lines, prescription_output
from mocap_id_assist.prescriptions import prescribe_from
from mocap_id_cli.console import Output, common_options


@common_options
def prescribe(
    config: Annotated[
        Path, Argument(metavar="CONFIG.yaml", help="The prescription's configuration (docs/prescribe.md).")
    ],
    *,
    out: Annotated[
        Path | None,
        Option(
            metavar="FOLDER",
            help="Folder for JSON, tables and figures; with the same folder, an interrupted search is continued.",
        ),
    ] = None,
    output: Output,
) -> None:
    """Find springs that let a weak person hold a wider range.

    The range is that of one joint or of a whole chain.
    """
    found = prescribe_from(load_prescription(config), out, output.report_stage, output.say)
    result, written = write_result(prescription_output(found), out, config)
    output.print_result(result.document, chain(prescription_lines(found), written))
    if found.refused is not None:
        raise typer.Exit(Refused.exit_code)
