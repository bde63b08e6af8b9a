"""``mocap-id regress``: has the answer of a recorded trial moved?"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from mocap_id.workflows.performing import Here
from mocap_id.workflows.regress import Baseline, Moved, Regression, update
from mocap_id.workflows.regress import regress as compare
from mocap_id.workflows.regress.regress import used
from mocap_id_cli.init import aligned
from mocap_id_cli.run import Quiet, Verbose, log_to_stderr, short
from mocap_id_cli.telling import teller


def regress(
    named: Annotated[
        list[str],
        typer.Argument(
            metavar="TRIALS...",
            help="Files of trials or studies, folders that hold some, or patterns.",
            show_default=False,
        ),
    ],
    *,
    baseline: Annotated[Path, typer.Option(metavar="FILE", help="The numbers to hold them against.")] = Path(
        "baseline.json"
    ),
    make: Annotated[
        bool, typer.Option("--update", help="Write the numbers as they are now into the baseline.")
    ] = False,
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Trials at a time.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="Print what moved as JSON.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run recorded trials anew and compare every headline number with a baseline.

    What was computed before is not used, and the trials' own results are not touched. The exit code is 1 where a number
    moved by more than its tolerance, by default the 95 % interval that was stated with it.
    """
    log_to_stderr(quiet, verbose)
    tell = teller(quiet)
    if make:
        before = Baseline.read(baseline) if baseline.exists() else Baseline()
        made = update(named, before, Here(jobs), tell)
        made.write(baseline)
        for trial, numbers in made.trials.items():
            if "exit_code" in numbers:
                typer.echo(f"{trial}: failed, exit code {numbers['exit_code'].value}: the baseline holds no more of it")
        typer.echo(f"baseline: {short(baseline.absolute())}, {len(made.trials)} trials")
        return
    found = compare(named, Baseline.read(baseline), Here(jobs), tell)
    if as_json:
        told = {"passed": found.passed, "compared": found.compared, "unknown": found.unknown}
        moved = [asdict(one) for one in found.moved]
        typer.echo(json.dumps(told | {"moved": moved}, indent=2, ensure_ascii=False, allow_nan=False))
    else:
        typer.echo("\n".join(_lines(found, baseline)))
    if not found.passed:
        raise typer.Exit(1)


def _lines(found: Regression, baseline: Path) -> Iterator[str]:
    if found.moved:
        titles = ["trial", "number", "baseline", "now", "moved by", "tolerance"]
        yield from aligned([titles, *(_row(one) for one in found.moved)])
    for trial in found.unknown:
        yield f"{trial}: the baseline knows nothing of it: `--update` takes it in"
    moved = {one.trial for one in found.moved}
    for trial, message in found.messages.items():
        if trial in moved:
            yield f"{trial}: {message}"
    trials = f" in {len(moved)} trials" if moved else ""
    yield f"{found.compared} numbers held against {short(baseline.absolute())}: {len(found.moved)} moved{trials}"
    if found.nearest is not None and used(found.nearest) > 0:
        near = found.nearest
        yield f"of the others {near.trial}, {near.name} used most of its tolerance: {100 * used(near):.2g} %"


def _row(one: Moved) -> list[str]:
    row = [one.trial, one.name, _said(one.before, one.unit), _said(one.now, one.unit)]
    if isinstance(one.before, float | int) and isinstance(one.now, float | int):
        return [*row, _said(one.now - one.before, one.unit), _said(one.tolerance, one.unit)]
    return [*row, "", "none"]


def _said(value: float | str | None, unit: str) -> str:
    if value is None:
        return "unknown"
    return value if isinstance(value, str) else f"{value:.6g} {unit}".rstrip()
