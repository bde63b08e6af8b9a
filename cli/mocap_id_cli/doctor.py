"""``mocap-id doctor``: checks of the installation."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

import mocap_id
import mocap_id_cli
from mocap_id_cli.console import AsJson, print_json

_WIDTH = 20


def doctor(
    *,
    full: Annotated[
        bool, typer.Option("--full", help="Also run the whole pipeline on a small simulated trial.")
    ] = False,
    warm: Annotated[
        bool,
        typer.Option(
            "--warm",
            help="Only compile the filter and the modules in advance, so that later runs start faster. The first time, "
            "this takes about a minute of processor time.",
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Check this installation and say how to repair it.

    The exit code is 1 if a check fails.
    """
    from mocap_id.workflows import doctor as workflow  # noqa: PLC0415  no other command has to wait for it

    if warm:
        typer.echo("compiling the filter: the first time, this takes about a minute of processor time", err=True)
        folders = [Path(str(package.__file__)).parent for package in (mocap_id, mocap_id_cli)]
        checks = workflow.compile_everything(folders)
    else:
        checks = workflow.check_installation(Path.cwd(), full=full)
    findings = []
    for finding in checks:
        findings.append(finding)
        if not as_json:
            typer.echo(f"{finding.level:<5} {finding.name:<{_WIDTH}} {finding.found}")
            if finding.advice:
                typer.echo(f"{'':<6}{'':<{_WIDTH}} to do: {finding.advice}")
    failed = [finding.name for finding in findings if finding.level == "fail"]
    if as_json:
        print_json([asdict(finding) for finding in findings])
    elif not warm:
        typer.echo(f"these checks failed: {', '.join(failed)}" if failed else "mocap-id works here")
    if failed:
        raise typer.Exit(1)
