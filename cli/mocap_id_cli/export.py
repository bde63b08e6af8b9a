"""``mocap-id export``: a run as files for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mocap_id_cli import progress
from mocap_id_cli.console import Quiet, TrialPath, Verbose, log_to_stderr, shorten


def export(
    trial: TrialPath,
    *,
    to: Annotated[
        list[str],
        typer.Option("--to", metavar="FORMAT", help="trc, mot, sto, csv, osim, ktk (repeatable).", show_default=False),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Output folder; default: `export` in the run folder.", show_default=False),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a run as OpenSim files or as tables.

    The formats trc, mot, sto and osim are for OpenSim, csv for tables, ktk for Kinetics Toolkit. If TRIAL is a YAML
    file, missing or outdated results are computed first; a run folder is read unchanged.
    """
    from mocap_id.workflows import export as workflow  # noqa: PLC0415  no other command has to wait for it

    log_to_stderr(quiet, verbose)
    formats = [name.strip() for each in to for name in each.split(",")]
    result = workflow.export(trial, formats, out, force=force, progress=progress.report_stages(quiet))
    for file in result.files:
        typer.echo(shorten(file))
    if not quiet:
        for note in result.notes:
            typer.echo(f"note: {note}", err=True)
