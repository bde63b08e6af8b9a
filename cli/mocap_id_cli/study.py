"""``mocap-id study``: many trials, and the tables over them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocap_id_cli import progress as live
from mocap_id_cli.run import Quiet, Verbose, log_to_stderr, short
from mocap_id_cli.telling import counting, teller

if TYPE_CHECKING:
    from mocap_id.workflows.study import Outcome

StudyFile = Annotated[Path, typer.Argument(metavar="STUDY.yaml", help="The study's file.", show_default=False)]


def study(
    file: StudyFile,
    *,
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Trials at a time.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="Print study.json.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run every trial of a study, then write the cohort's tables and page; what is up to date is reused.

    A trial that fails or is refused stops no other; the exit code is then 1.
    """
    from mocap_id.workflows import study as workflow  # noqa: PLC0415  no other command has to wait for it

    log_to_stderr(quiet, verbose)
    found = workflow.run(file, jobs, begin=counting(quiet), tell=teller(quiet))
    live.stop()
    if as_json:
        typer.echo(json.dumps(found.document, indent=2, ensure_ascii=False, allow_nan=False))
    else:
        typer.echo("\n".join(_lines(found)))
    if found.failed:
        raise typer.Exit(1)


def _lines(found: Outcome) -> Iterator[str]:
    verdicts = found.document["trials"]
    width = max(len(trial["trial"]) for trial in verdicts)
    for trial, done in zip(verdicts, found.performed, strict=True):
        yield f"{trial['trial']:<{width}}  {_verdict(trial)}"
        if done.message is not None:  # files by their names: whoever runs it has to find them
            yield from (f"{'':<{width}}    {line}" for line in done.message.splitlines())
    yield f"{len(verdicts) - len(found.failed)} of {len(verdicts)} trials went through"
    yield f"tables: {short(found.study.folder)}"
    yield f"page: {short(found.page)}"


def _verdict(trial: Mapping[str, Any]) -> str:
    about = ", ".join(trial["codes"])
    if trial["verdict"] == "failed":
        about = f"exit code {trial['exit_code']}"
    return f"{trial['verdict']}" + (f" ({about})" if about else "")
