"""``mocap-id study``: all trials of a study, with its tables and page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocap_id_cli import progress
from mocap_id_cli.console import Quiet, Verbose, log_to_stderr, print_json, short

if TYPE_CHECKING:
    from mocap_id.workflows.study import StudyResult

StudyFile = Annotated[Path, typer.Argument(metavar="STUDY.yaml", help="The study's file.", show_default=False)]


def study(
    file: StudyFile,
    *,
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Number of trials at a time.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="Print study.json.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run all trials of a study and write its tables and page.

    Results that are up to date are reused. If a trial fails or is refused, the others still run and the exit code
    is 1.
    """
    from mocap_id.workflows import study as workflow  # noqa: PLC0415  no other command has to wait for it

    log_to_stderr(quiet, verbose)
    found = workflow.run_study(file, jobs, begin=progress.trial_count(quiet), tell=progress.of_trials(quiet))
    progress.stop()
    if as_json:
        print_json(found.document)
    else:
        typer.echo("\n".join(_lines(found)))
    if found.failed:
        raise typer.Exit(1)


def _lines(found: StudyResult) -> Iterator[str]:
    verdicts = found.document["trials"]
    width = max(len(trial["trial"]) for trial in verdicts)
    for trial, done in zip(verdicts, found.runs, strict=True):
        yield f"{trial['trial']:<{width}}  {_verdict(trial)}"
        if done.message is not None:  # names the files, which the user has to find
            yield from (f"{'':<{width}}    {line}" for line in done.message.splitlines())
    yield f"{len(verdicts) - len(found.failed)} of {len(verdicts)} trials went through"
    yield f"tables: {short(found.study.folder)}"
    yield f"page: {short(found.page)}"


def _verdict(trial: Mapping[str, Any]) -> str:
    about = ", ".join(trial["codes"])
    if trial["verdict"] == "failed":
        about = f"exit code {trial['exit_code']}"
    return f"{trial['verdict']}" + (f" ({about})" if about else "")
