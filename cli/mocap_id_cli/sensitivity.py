"""``mocap-id sensitivity``: tolerance of a trial to laboratory errors."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocap_id_cli import progress
from mocap_id_cli.console import AsJson, Quiet, TrialPath, Verbose, log_to_stderr, print_result, shorten

if TYPE_CHECKING:
    from mocap_id.workflows.sensitivity.runs import PerturbationRun
    from mocap_id.workflows.sensitivity.study import SensitivityResult


def sensitivity(
    trial: TrialPath,
    *,
    settings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML file of the perturbations; default: all perturbations.")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND", help="Apply only this kind, such as clock-offset (repeatable; docs/sensitivity.md)."
        ),
    ] = None,
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", min=1, help="Number of perturbations that run at the same time.")
    ] = 2,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Output folder; default: <run folder>-sensitivity.")
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Perturb a trial and report which errors it tolerates.

    The perturbations are typical laboratory errors (thesis 5.5.2). If TRIAL is a YAML file, missing or outdated
    results are computed first. A given run folder is not changed.
    """
    from mocap_id.workflows.sensitivity import study  # noqa: PLC0415  no other command has to wait for it

    log_to_stderr(quiet, verbose)
    options = study.SensitivityOptions() if settings is None else study.read_options(settings)
    options = options.only(only or ())
    start = time.perf_counter()
    result = study.sensitivity(
        trial, options, jobs=jobs, out=out, progress=progress.report_stages(quiet), tell=_report_runs(quiet)
    )
    if not quiet:
        runs, wall = result.runs, time.perf_counter() - start
        spent = sum(run.seconds for run in runs)
        typer.echo(f"perturbations: {len(runs)}, {spent:.1f} s of processor time, {wall:.1f} s in all", err=True)
    print_result(as_json, result.document, _lines(result, options.tolerance))


def _report_runs(quiet: bool) -> Any:
    def report(run: PerturbationRun, number: int, count: int) -> None:
        outcome = "" if run.estimates is not None else "  refused" if run.refused else "  failed"
        typer.echo(f"{number:>4}/{count}  {run.perturbation.name:<36}{run.seconds:6.2f} s{outcome}", err=True)

    return (lambda run, number, count: None) if quiet else report


def _lines(result: SensitivityResult, share: float) -> Iterator[str]:
    from mocap_id.reporting.sensitivity import describe_criterion  # noqa: PLC0415  as above

    yield f"{result.trial}: what this trial tolerates. {describe_criterion(share)}"
    if result.note:
        yield f"note: {result.note}"
    yield from (f"  {row['sentence']}" for row in result.document["tolerates"])
    yield f"written: {shorten(result.folder.absolute())}"
