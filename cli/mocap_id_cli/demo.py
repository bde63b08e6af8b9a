"""``mocap-id demo``: a simulated trial, from recording to report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

import mocap_id
from mocap_id.errors import StoreError
from mocap_id_cli.console import Quiet, Verbose, shorten
from mocap_id_cli.run import run


def demo(
    folder: Annotated[Path, typer.Argument(metavar="[FOLDER]", help="Folder of the trial.")] = Path("mocap-id-demo"),
    *,
    open_report: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the report in the browser, if there is one.")
    ] = True,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Simulate a sit-to-stand, run it and open its report.

    You need no recording. FOLDER then contains the simulated recording, its exact truth, trial.yaml and the results,
    as for a trial of your own. If you repeat the command, the files are reused.
    """
    trial = folder / "trial.yaml"
    if not trial.exists():
        mocap_id.simulate("sit-to-stand", folder, seed=1, repetitions=3)
    elif not _is_demo(folder):
        raise StoreError(
            f"{folder} contains another trial, not the demonstration: choose a new folder, or run that trial with "
            f"`mocap-id run {trial}`"
        )
    typer.echo(f"trial: {shorten(trial.absolute())}")
    run(trial, open_report=open_report, quiet=quiet, verbose=verbose)


def _is_demo(folder: Path) -> bool:
    """Return whether the trial in a folder is the simulated sit-to-stand of this command."""
    try:
        truth = json.loads((folder / "truth.json").read_text("utf-8"))
        return (truth["kind"], truth["seed"]) == ("sts", 1)
    except (OSError, ValueError, KeyError, TypeError):
        return False
