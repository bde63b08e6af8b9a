"""``mocap-id doctor``: checks of the installation."""

from __future__ import annotations

from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

import mocap_id
from mocap_id_cli.console import AsJson, print_json

_WIDTH = 20
_PACKAGES = ("mocap_id", "mocap_id_simulation", "mocap_id_cli")


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
        found = [find_spec(name) for name in _PACKAGES]
        checks = workflow.compile_everything([Path(str(each.origin)).parent for each in found if each is not None])
    else:
        checks = workflow.check_installation(Path.cwd(), simulate=simulate_small_trial if full else None)
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


def simulate_small_trial(folder: Path) -> Path:
    """Simulate a small trial of a robot's joint, and return the path of its YAML file."""
    return mocap_id.simulate("robot", folder, seed=1, repetitions=2, rate=100.0, analog_rate=500.0)
