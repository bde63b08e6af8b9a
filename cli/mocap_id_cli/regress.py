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
from mocap_id_cli import progress
from mocap_id_cli.console import (
    AsJson,
    Jobs,
    Quiet,
    TrialFiles,
    Verbose,
    align,
    count_trials,
    log_to_stderr,
    print_result,
    shorten,
)


def regress(
    named: TrialFiles,
    *,
    baseline: Annotated[Path, typer.Option(metavar="FILE", help="File of the baseline.")] = Path("baseline.json"),
    make: Annotated[bool, typer.Option("--update", help="Write the recomputed results to the baseline.")] = False,
    jobs: Jobs = 1,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Recompute trials, and compare their results with a baseline.

    Earlier results are neither used nor changed. The exit code is 1 if a number has changed by more than its
    tolerance, which by default is its 95 % interval.
    """
    log_to_stderr(quiet, verbose)
    tell = progress.report_trials(quiet)
    if make:
        before = Baseline.read(baseline) if baseline.exists() else Baseline()
        made = update(named, before, LocalBackend(jobs), tell)
        made.write(baseline)
        for trial, numbers in made.trials.items():
            if "exit_code" in numbers:
                code = numbers["exit_code"].value
                typer.echo(f"{trial}: failed, exit code {code}; the baseline contains only this code")
        typer.echo(f"baseline: {shorten(baseline.absolute())}, {count_trials(len(made.trials))}")
        return
    result = compare(named, Baseline.read(baseline), LocalBackend(jobs), tell)
    document = {"passed": result.passed, "compared": result.compared, "unknown": result.unknown}
    print_result(as_json, document | {"moved": [asdict(one) for one in result.moved]}, _lines(result, baseline))
    if not result.passed:
        raise typer.Exit(1)


def _lines(result: Regression, baseline: Path) -> Iterator[str]:
    if result.moved:
        titles = ["trial", "number", "baseline", "now", "moved by", "tolerance"]
        yield from align([titles, *(_row(one) for one in result.moved)])
    for trial in result.unknown:
        yield f"{trial}: not in the baseline: add it with `--update`"
    moved = {one.trial for one in result.moved}
    yield from (f"{trial}: {message}" for trial, message in result.messages.items() if trial in moved)
    trials = f" in {count_trials(len(moved))}" if moved else ""
    yield f"{result.compared} numbers compared with {shorten(baseline.absolute())}: {len(result.moved)} moved{trials}"
    near = result.nearest
    if near is not None and near.tolerance_used > 0:
        yield f"largest change within tolerance: {near.trial}, {near.name}, {100 * near.tolerance_used:.2g} % of it"


def _row(one: Change) -> list[str]:
    row = [one.trial, one.name, _format(one.before, one.unit), _format(one.now, one.unit)]
    if isinstance(one.before, float | int) and isinstance(one.now, float | int):
        return [*row, _format(one.now - one.before, one.unit), _format(one.tolerance, one.unit)]
    return [*row, "", "none"]


def _format(value: float | str | None, unit: str) -> str:
    if value is None:
        return "unknown"
    return value if isinstance(value, str) else f"{value:.6g} {unit}".rstrip()
