"""``mocap-id sensitivity``: tolerance of a trial to laboratory errors."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocap_id_cli import progress
from mocap_id_cli.console import Quiet, TrialPath, Verbose, log_to_stderr, print_json, short

if TYPE_CHECKING:
    from mocap_id.workflows.sensitivity.runs import PerturbationRun
    from mocap_id.workflows.sensitivity.study import SensitivityOutput


def sensitivity(
    trial: TrialPath,
    *,
    settings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML file of the perturbations to apply; default: all.")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND", help="Apply only this kind, such as clock-offset (repeatable; docs/sensitivity.md)."
        ),
    ] = None,
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Number of perturbations at a time.")] = 2,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Output folder; default: <run folder>-sensitivity.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print sensitivity.json.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Perturb a trial and report which errors it tolerates.

    The perturbations are typical laboratory errors (thesis 5.5.2). With a YAML file, missing or outdated results
    are computed first. The trial's run folder is not changed.
    """
    from mocap_id.workflows.sensitivity import plan, study  # noqa: PLC0415  no other command has to wait for it

    log_to_stderr(quiet, verbose)
    chosen = (plan.SensitivityOptions() if settings is None else plan.read_options(settings)).only(only or ())
    start = time.perf_counter()
    found = study.sensitivity(
        trial, chosen, jobs=jobs, out=out, progress=progress.of_stages(quiet), tell=_report(quiet)
    )
    if not quiet:
        spent = sum(one.seconds for one in found.result.runs)
        wall = time.perf_counter() - start
        typer.echo(
            f"perturbations: {len(found.result.runs)}, {spent:.1f} s of processor time, {wall:.1f} s in all", err=True
        )
    if as_json:
        print_json(found.document)
    else:
        typer.echo("\n".join(_lines(found, chosen.tolerance)))


def _report(quiet: bool) -> Any:
    def tell(done: PerturbationRun, number: int, count: int) -> None:
        fate = "" if done.estimates is not None else "  refused" if done.refused else "  failed"
        typer.echo(f"{number:>4}/{count}  {done.perturbation.name:<36}{done.seconds:6.2f} s{fate}", err=True)

    return (lambda done, number, count: None) if quiet else tell


def _lines(found: SensitivityOutput, share: float) -> Iterator[str]:
    from mocap_id.reporting.sensitivity.page import criterion  # noqa: PLC0415  as above

    yield f"{found.result.trial}: what this trial tolerates. {criterion(share)}"
    if found.result.note:
        yield f"note: {found.result.note}"
    yield from (f"  {row['sentence']}" for row in found.document["tolerates"])
    yield f"written: {short(found.folder.absolute())}"
