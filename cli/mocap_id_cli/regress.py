"""``mocap-id regress``: comparison of recomputed trials with a baseline."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from mocap_id.workflows.parallel import LocalBackend
from mocap_id.workflows.regress import Baseline, Change, Regression, update
from mocap_id.workflows.regress import regress as compare
from mocap_id.workflows.regress.regression_check import tolerance_used
from mocap_id_cli import progress
from mocap_id_cli.console import (
    Quiet,
    TrialFiles,
    Verbose,
    aligned,
    log_to_stderr,
    print_json,
    short,
)


def regress(
    named: TrialFiles,
    *,
    baseline: Annotated[Path, typer.Option(metavar="FILE", help="The baseline.")] = Path("baseline.json"),
    make: Annotated[bool, typer.Option("--update", help="Write the current numbers to the baseline.")] = False,
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Number of trials at a time.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="Print the changes as JSON.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Recompute trials and compare their results with a baseline.

    Earlier results are neither used nor changed. The exit code is 1 if a number has changed by more than its
    tolerance, by default its 95 % interval.
    """
    log_to_stderr(quiet, verbose)
    tell = progress.of_trials(quiet)
    if make:
        before = Baseline.read(baseline) if baseline.exists() else Baseline()
        made = update(named, before, LocalBackend(jobs), tell)
        made.write(baseline)
        for trial, numbers in made.trials.items():
            if "exit_code" in numbers:
                typer.echo(
                    f"{trial}: failed, exit code {numbers['exit_code'].value}; the baseline holds only this code"
                )
        typer.echo(f"baseline: {short(baseline.absolute())}, {_trials(len(made.trials))}")
        return
    found = compare(named, Baseline.read(baseline), LocalBackend(jobs), tell)
    if as_json:
        result = {"passed": found.passed, "compared": found.compared, "unknown": found.unknown}
        print_json(result | {"moved": [asdict(one) for one in found.moved]})
    else:
        typer.echo("\n".join(_lines(found, baseline)))
    if not found.passed:
        raise typer.Exit(1)


def _lines(found: Regression, baseline: Path) -> Iterator[str]:
    if found.moved:
        titles = ["trial", "number", "baseline", "now", "moved by", "tolerance"]
        yield from aligned([titles, *(_row(one) for one in found.moved)])
    for trial in found.unknown:
        yield f"{trial}: not in the baseline: add it with `--update`"
    moved = {one.trial for one in found.moved}
    for trial, message in found.messages.items():
        if trial in moved:
            yield f"{trial}: {message}"
    trials = f" in {_trials(len(moved))}" if moved else ""
    yield f"{found.compared} numbers compared with {short(baseline.absolute())}: {len(found.moved)} moved{trials}"
    if found.nearest is not None and tolerance_used(found.nearest) > 0:
        near = found.nearest
        yield f"largest change within tolerance: {near.trial}, {near.name}, {100 * tolerance_used(near):.2g} % of it"


def _trials(count: int) -> str:
    return f"{count} trial{'s' * (count != 1)}"


def _row(one: Change) -> list[str]:
    row = [one.trial, one.name, _shown(one.before, one.unit), _shown(one.now, one.unit)]
    if isinstance(one.before, float | int) and isinstance(one.now, float | int):
        return [*row, _shown(one.now - one.before, one.unit), _shown(one.tolerance, one.unit)]
    return [*row, "", "none"]


def _shown(value: float | str | None, unit: str) -> str:
    if value is None:
        return "unknown"
    return value if isinstance(value, str) else f"{value:.6g} {unit}".rstrip()
