"""``mocap-id study``: runs of all trials of a study, with tables and page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocap_id_cli import progress
from mocap_id_cli.console import AsJson, Jobs, Quiet, Verbose, describe_verdict, log_to_stderr, print_result, shorten

if TYPE_CHECKING:
    from mocap_id.workflows.study import StudyResult


def study(
    file: Annotated[Path, typer.Argument(metavar="STUDY.yaml", help="The study's file.", show_default=False)],
    *,
    jobs: Jobs = 1,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run all trials of a study and write its tables and page.

    Results that are up to date are reused. If a trial fails or is refused, the other trials still run, and the exit
    code is 1.
    """
    from mocap_id.workflows import study as workflow  # noqa: PLC0415  no other command has to wait for it

    log_to_stderr(quiet, verbose)
    result = workflow.run_study(file, jobs, begin=progress.show_trial_count(quiet), tell=progress.report_trials(quiet))
    progress.stop()
    print_result(as_json, result.document, _lines(result))
    if result.failed:
        raise typer.Exit(1)


def _lines(result: StudyResult) -> Iterator[str]:
    trials = result.document["trials"]
    width = max(len(trial["trial"]) for trial in trials)
    for trial, run in zip(trials, result.runs, strict=True):
        yield f"{trial['trial']:<{width}}  {describe_verdict(trial)}"
        if run.message is not None:  # unlike the document, it names the files, which the user has to find
            yield from (f"{'':<{width}}    {line}" for line in run.message.splitlines())
    yield from (f"note: {remark}" for remark in result.document["remarks"])
    yield f"{len(trials) - len(result.failed)} of {len(trials)} trials have results"
    yield f"tables: {shorten(result.study.folder)}"
    yield f"page: {shorten(result.page)}"
