"""``mocap-id sensitivity``: what a trial tolerates."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mocap_id_cli.run import Quiet, Verbose, log_to_stderr, progress, short

if TYPE_CHECKING:
    from mocap_id.workflows.sensitivity.study import Outcome
    from mocap_id.workflows.sensitivity.trying import Tried


def sensitivity(
    trial: Annotated[
        Path,
        typer.Argument(metavar="TRIAL", help="The trial to perturb: YAML or run folder.", show_default=False),
    ],
    *,
    settings: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML list of what to try, instead of everything.")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND", help="Try this kind alone, such as clock-offset; repeat for more (docs/sensitivity.md)."
        ),
    ] = None,
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Perturbations at a time.")] = 2,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Where to write; default: <run folder>-sensitivity.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print sensitivity.json.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Perturb a trial in every way that a lab meets, and say what its parameters tolerate (thesis 5.5.2).

    What a YAML file asks for and is not there yet is computed first. The trial's own run folder is only read.
    """
    from mocap_id.workflows.sensitivity import asking, study  # noqa: PLC0415  no other command has to wait for it

    log_to_stderr(quiet, verbose)
    asked = (asking.Asked() if settings is None else asking.read_asked(settings)).only(only or ())
    start = time.perf_counter()
    found = study.sensitivity(trial, asked, jobs=jobs, out=out, progress=progress(quiet), tell=_teller(quiet))
    if not quiet:
        spent = sum(one.seconds for one in found.studied.tried)
        wall = time.perf_counter() - start
        typer.echo(
            f"{len(found.studied.tried)} perturbations, {spent:.1f} s of processor time, {wall:.1f} s in all", err=True
        )
    if as_json:
        typer.echo(json.dumps(found.document, indent=2, ensure_ascii=False, allow_nan=False))
    else:
        typer.echo("\n".join(_lines(found, asked.tolerance)))


def _teller(quiet: bool) -> Any:
    def tell(done: Tried, number: int, count: int) -> None:
        fate = "" if done.result is not None else "  refused" if done.refused else "  failed"
        typer.echo(f"{number:>4}/{count}  {done.change.name:<36}{done.seconds:6.2f} s{fate}", err=True)

    return (lambda done, number, count: None) if quiet else tell


def _lines(found: Outcome, share: float) -> Iterator[str]:
    from mocap_id.reporting.sensitivity.page import criterion  # noqa: PLC0415  as above

    yield f"{found.studied.trial}: what this trial tolerates. {criterion(share)}"
    if found.studied.note:
        yield f"note: {found.studied.note}"
    yield from (f"  {row['sentence']}" for row in found.document["tolerates"])
    yield f"written: {short(found.folder.absolute())}"
