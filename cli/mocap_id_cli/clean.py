"""``mocap-id clean``: deletion of results."""

from __future__ import annotations

from typing import Annotated

import typer

from mocap_id import runner
from mocap_id.errors import ConfigError
from mocap_id.stages import STAGE_HELP
from mocap_id.store import Folder
from mocap_id.workflows.batch import find_readable_trials
from mocap_id_cli.console import TrialFiles, offer, shorten


def clean(
    named: TrialFiles,
    *,
    first: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="STAGE",
            help="Delete the results from this stage on; keep the results of earlier stages.",
            autocompletion=offer(*STAGE_HELP),
        ),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what would be deleted, and delete nothing.")] = False,
) -> None:
    """Delete the results of runs.

    Recordings, configurations and all other files are kept.
    """
    if first is not None and first not in STAGE_HELP:
        raise ConfigError(f"--from {first}: there is no such stage, expected one of {', '.join(STAGE_HELP)}")
    for trial in find_readable_trials(named):
        has_results = Folder(trial.out).is_present()
        if has_results and not dry_run:
            runner.clean(trial, first)
        outcome = ("would be cleaned" if dry_run else "cleaned") if has_results else "has no results"
        typer.echo(f"{trial.name}: {shorten(trial.out)} {outcome}")
