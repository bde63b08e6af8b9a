"""Commands that help the user: ``explain`` and ``doctor``."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

import mocap_id
from mocap_id import workflows
from mocap_id_cli.console import AsJson, Output, print_json

_PACKAGES = ("mocap_id", "mocap_id_assist", "mocap_id_simulation", "mocap_id_cli")
_TEXT_WIDTH, _NAME_WIDTH = 100, 20


def _complete_code() -> list[tuple[str, str]]:
    """Return each code with its title, for completion in the shell."""
    return [(entry.code, entry.title) for entry in workflows.code_lookup.list_entries().values()]


def explain(
    code: Annotated[
        str | None,
        Argument(
            metavar="[CODE]",
            help="A verdict's code, an exit code or an error's name; all codes are listed if omitted.",
            autocompletion=_complete_code,
        ),
    ] = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Explain a verdict's code, an error or an exit code.

    The explanation contains the meaning, the criterion and what to do.
    """
    if code is None:
        entries = list(workflows.code_lookup.list_entries().values())
        Output(as_json).print_result([asdict(entry) for entry in entries], _list_codes(entries))
    else:
        entry = workflows.code_lookup.explain_code(code)
        Output(as_json).print_result(asdict(entry), _describe(entry))


def _list_codes(entries: list[workflows.code_lookup.CodeEntry]) -> Iterator[str]:
    width = max(len(entry.code) for entry in entries)
    for entry in entries:
        levels = " or ".join(entry.levels) or "exit code"
        yield f"{entry.code:<{width}}  {levels:<15}  {entry.title}"


def _describe(entry: workflows.code_lookup.CodeEntry) -> Iterator[str]:
    levels = f" ({' or '.join(entry.levels)})" if entry.levels else ""
    yield f"{entry.code}{levels}: {entry.title}"
    for name, text in (("means", entry.meaning), ("judged", entry.judged), ("to do", entry.action)):
        if text:
            yield ""
            yield from textwrap.wrap(f"{name:<8}{text}", _TEXT_WIDTH, subsequent_indent=" " * 8, break_on_hyphens=False)


def doctor(
    *,
    full: Annotated[bool, Option("--full", help="Also run the whole pipeline on a small simulated trial.")] = False,
    warm: Annotated[
        bool,
        Option(
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
    if warm:
        typer.echo("compiling the filter: the first time, this takes about a minute of processor time", err=True)
        found = [find_spec(name) for name in _PACKAGES]
        folders = [Path(str(each.origin)).parent for each in found if each is not None]
        checks = workflows.doctor.compile_everything(folders)
    else:
        checks = workflows.doctor.check_installation(Path.cwd(), simulate=simulate_small_trial if full else None)
    findings = []
    for finding in checks:
        findings.append(finding)
        if not as_json:
            typer.echo(f"{finding.level:<5} {finding.name:<{_NAME_WIDTH}} {finding.found}")
            if finding.advice:
                typer.echo(f"{'':<6}{'':<{_NAME_WIDTH}} to do: {finding.advice}")
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
