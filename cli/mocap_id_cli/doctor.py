"""``mocap-id doctor``: checks of the installation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import mocap_id
import mocap_id_cli
from mocap_id_cli.console import AsJson, print_json

if TYPE_CHECKING:
    from mocap_id.workflows.doctor import Finding

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
            help="Check nothing; compile the filter and the modules, so that no run has to. The first time this takes "
            "about a minute of processor time.",
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Check this installation and say how to repair it.

    The exit code is 1 if a check fails.
    """
    from mocap_id.workflows import doctor as workflow  # noqa: PLC0415  no other command has to wait for it

    if warm:
        typer.echo("compiling the filter: the first time, about a minute of processor time", err=True)
    found = []
    for check in _compile() if warm else workflow.check_installation(Path.cwd(), full=full):
        found.append(check)
        if not as_json:
            typer.echo(f"{check.level:<5} {check.name:<{_WIDTH}} {check.found}")
            if check.advice:
                typer.echo(f"{'':<6}{'':<{_WIDTH}} to do: {check.advice}")
    failed = [check.name for check in found if check.level == "fail"]
    if as_json:
        print_json([asdict(check) for check in found])
    elif not warm:
        typer.echo(f"does not work: {', '.join(failed)}" if failed else "mocap-id works here")
    if failed:
        raise typer.Exit(1)


def _compile() -> Iterator[Finding]:
    """Compile the modules, then the filter."""
    from mocap_id.workflows import doctor as workflow  # noqa: PLC0415  as above

    yield workflow.compile_modules([Path(str(package.__file__)).parent for package in (mocap_id, mocap_id_cli)])
    yield workflow.compile_filter()
