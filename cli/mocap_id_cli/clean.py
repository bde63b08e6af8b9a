"""``mocap-id clean``: deletion of results."""

from __future__ import annotations

from typing import Annotated

import typer

from mocap_id import runner
from mocap_id.errors import ConfigError
from mocap_id.stages import STAGE_HELP
from mocap_id.store import Folder
from mocap_id.workflows.batch import find_trials
from mocap_id_cli.console import TrialFiles, one_of, short


def clean(
    named: TrialFiles,
    *,
    first: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="STAGE",
            help="Keep the results of the stages before this one.",
            autocompletion=one_of(*STAGE_HELP),
        ),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what would be deleted, and delete nothing.")] = False,
) -> None:
    """Delete the results of runs.

    Recordings, configurations and all other files are kept.
    """
    if first is not None and first not in STAGE_HELP:
        raise ConfigError(f"--from {first}: there is no such stage, expected one of {', '.join(STAGE_HELP)}")
    trials, unreadable = find_trials(named)
    if unreadable:
        raise ConfigError("\n".join(str(one.error) for one in unreadable))
    for trial in trials:
        there = Folder(trial.out).is_present()
        if there and not dry_run:
            runner.clean(trial, first)
        did = ("would be cleaned" if dry_run else "cleaned") if there else "has nothing"
        typer.echo(f"{trial.name}: {short(trial.out)} {did}")
