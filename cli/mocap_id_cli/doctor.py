"""``mocap-id doctor``: whether this installation works."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

_WIDTH = 20


def doctor(
    *,
    full: Annotated[
        bool, typer.Option("--full", help="Run the whole pipeline on a small simulated trial too.")
    ] = False,
    warm: Annotated[
        bool, typer.Option("--warm", help="Check nothing: compile the filter, so that the first run need not.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check this installation: what is needed, what is there, and what to do; exit code 1 where something fails."""
    from mocap_id.workflows import doctor as look  # noqa: PLC0415  no other command has to wait for it

    found = []
    for check in [look.warm()] if warm else look.examine(Path.cwd(), full=full):
        found.append(check)
        if not as_json:
            typer.echo(f"{check.level:<5} {check.name:<{_WIDTH}} {check.found}")
            if check.advice:
                typer.echo(f"{'':<6}{'':<{_WIDTH}} to do: {check.advice}")
    failed = [check.name for check in found if check.level == "fail"]
    if as_json:
        typer.echo(json.dumps([asdict(check) for check in found], indent=2, ensure_ascii=False))
    elif not warm:
        typer.echo(f"does not work: {', '.join(failed)}" if failed else "mocap-id works here")
    if failed:
        raise typer.Exit(1)
