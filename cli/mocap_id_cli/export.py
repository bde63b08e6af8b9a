"""``mocap-id export``: a run as files of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mocap_id_cli.run import Quiet, Verbose, log_to_stderr, progress, short


def export(
    trial: Annotated[
        Path, typer.Argument(metavar="TRIAL", help="A trial's YAML file or run folder.", show_default=False)
    ],
    *,
    to: Annotated[
        list[str],
        typer.Option("--to", metavar="FORMAT", help="trc, mot, sto, csv or osim; repeatable.", show_default=False),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Where to write; default: export in the run folder.", show_default=False),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite what is there.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a run for OpenSim (trc, mot, sto, osim) or as tables (csv).

    What a YAML file asks for and is not there yet is computed first; a run folder is taken as it is.
    """
    from mocap_id.workflows import export as workflow  # noqa: PLC0415  no other command has to wait for it

    log_to_stderr(quiet, verbose)
    formats = [name.strip() for each in to for name in each.split(",")]
    done = workflow.export(trial, formats, out, force=force, progress=progress(quiet))
    for file in done.files:
        typer.echo(short(file))
    if not quiet:
        for note in done.notes:
            typer.echo(f"note: {note}", err=True)
