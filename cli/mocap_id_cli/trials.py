"""Commands on many trials: ``batch``, ``regress``, ``status`` and ``clean``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from mocap_id import runner, workflows
from mocap_id.config import Trial
from mocap_id.config.parsing import read_source
from mocap_id.errors import ConfigError
from mocap_id.stages import STAGE_HELP
from mocap_id.store import Folder
from mocap_id.workflows.parallel import Backend, DaskBackend, LocalBackend, OnError
from mocap_id_cli import progress
from mocap_id_cli.console import (
    AsJson,
    Jobs,
    Output,
    TrialFiles,
    align,
    common_options,
    count_trials,
    describe_verdict,
    offer,
    print_json,
    shorten,
)

_MOST_ROWS = 40  # for more trials, `batch` prints only the trials that did not succeed


@common_options
def batch(
    named: Annotated[
        list[str],
        Argument(
            metavar="STUDY_OR_GLOB...",
            help="Trial or study files, folders of such files, or patterns such as 'lab/*/trial.yaml'.",
        ),
    ],
    *,
    jobs: Jobs = 1,
    scheduler: Annotated[
        str | None, Option(metavar="ADDRESS", help="Address of a running Dask scheduler, such as tcp://node1:8786.")
    ] = None,
    cluster: Annotated[
        Path | None, Option(metavar="CLUSTER.yaml", help="Settings of a cluster that Dask should start (SSH, SLURM …).")
    ] = None,
    on_error: Annotated[
        OnError, Option(help="After a failed trial: continue with the other trials, or stop.")
    ] = "continue",
    out: Annotated[Path, Option(metavar="FILE", help="File for the table, .parquet.")] = Path("batch.parquet"),
    output: Output,
) -> None:
    """Run many trials and write one table of their results.

    Results that are up to date are reused. If a trial fails or is refused, the other trials still run, and the exit
    code is 1. After an interruption, the same command continues where it stopped.
    """
    if out.suffix != ".parquet":
        raise ConfigError(f"{out}: the table is written as a Parquet file: choose a name that ends in .parquet")
    result = workflows.batch.run_batch(
        named,
        out,
        backend=_choose_backend(jobs, scheduler, cluster),
        on_error=on_error,
        begin=output.show_trial_count,
        tell=output.report_trial,
    )
    progress.stop()
    output.print_result(result.rows, _describe_batch(result))
    if result.failed:
        raise typer.Exit(1)


def _choose_backend(jobs: int, scheduler: str | None, cluster: Path | None) -> Backend:
    options = {"--jobs": jobs > 1, "--scheduler": scheduler, "--cluster": cluster}
    chosen = [name for name, given in options.items() if given]
    if len(chosen) > 1:
        raise ConfigError(f"{' and '.join(chosen)}: choose only one of these options")
    if cluster is not None:
        data = read_source(cluster.absolute()).data
        if not isinstance(data, dict):
            raise ConfigError(f"{cluster}: expected keys such as `kind:` and `workers:`")
        return DaskBackend(cluster=data)
    return LocalBackend(jobs) if scheduler is None else DaskBackend(scheduler)


def _describe_batch(result: workflows.batch.Batch) -> Iterator[str]:
    total = len(result.rows)
    rows = [(k, row) for k, row in enumerate(result.rows) if total <= _MOST_ROWS or row["exit_code"] != 0]
    width = max((len(row["trial"]) for _, row in rows), default=0)
    for number, row in rows:
        yield f"{row['trial']:<{width}}  {describe_verdict(row)}"
        yield from (f"{'':<{width}}    {line}" for line in result.messages.get(number, "").splitlines())
    counts = Counter(row["verdict"] for row in result.rows)
    yield f"{count_trials(total)}: " + ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    yield f"table: {shorten(result.table)}"


@common_options
def regress(
    named: TrialFiles,
    *,
    baseline: Annotated[Path, Option(metavar="FILE", help="File of the baseline.")] = Path("baseline.json"),
    make: Annotated[bool, Option("--update", help="Write the recomputed results to the baseline.")] = False,
    jobs: Jobs = 1,
    output: Output,
) -> None:
    """Recompute trials, and compare their results with a baseline.

    Earlier results are neither used nor changed. The exit code is 1 if a number has changed by more than its
    tolerance, which by default is its 95 % interval.
    """
    workflow = workflows.regress
    if make:
        before = workflow.Baseline.read(baseline) if baseline.exists() else workflow.Baseline()
        made = workflow.update(named, before, LocalBackend(jobs), output.report_trial)
        made.write(baseline)
        for trial, numbers in made.trials.items():
            if "exit_code" in numbers:
                code = numbers["exit_code"].value
                typer.echo(f"{trial}: failed, exit code {code}; the baseline contains only this code")
        typer.echo(f"baseline: {shorten(baseline.absolute())}, {count_trials(len(made.trials))}")
        return
    result = workflow.check_trials(named, workflow.Baseline.read(baseline), LocalBackend(jobs), output.report_trial)
    document = {"passed": result.passed, "compared": result.compared, "unknown": result.unknown}
    document |= {"moved": [asdict(one) for one in result.moved]}
    output.print_result(document, _describe_regression(result, baseline))
    if not result.passed:
        raise typer.Exit(1)


def _describe_regression(result: workflows.regress.Regression, baseline: Path) -> Iterator[str]:
    if result.moved:
        rows = [["trial", "number", "baseline", "now", "moved by", "tolerance"]]
        for one in result.moved:
            change = ["", "none"]
            if isinstance(one.before, float | int) and isinstance(one.now, float | int):
                change = [_format_value(one.now - one.before, one.unit), _format_value(one.tolerance, one.unit)]
            values = [_format_value(value, one.unit) for value in (one.before, one.now)]
            rows.append([one.trial, one.name, *values, *change])
        yield from align(rows)
    for trial in result.unknown:
        yield f"{trial}: not in the baseline: add it with `--update`"
    moved = {one.trial for one in result.moved}
    yield from (f"{trial}: {message}" for trial, message in result.messages.items() if trial in moved)
    trials = f" in {count_trials(len(moved))}" if moved else ""
    yield f"{result.compared} numbers compared with {shorten(baseline.absolute())}: {len(result.moved)} moved{trials}"
    near = result.nearest
    if near is not None and near.tolerance_used > 0:
        yield f"largest change within tolerance: {near.trial}, {near.name}, {100 * near.tolerance_used:.2g} % of it"


def _format_value(value: float | str | None, unit: str) -> str:
    if value is None:
        return "unknown"
    return value if isinstance(value, str) else f"{value:.6g} {unit}".rstrip()


def status(named: TrialFiles, *, as_json: AsJson = False) -> None:
    """Show what is done, what has to be computed, and what failed.

    A folder stands for the files of trials and studies in it, and for the run folders in it. Nothing is computed or
    written.
    """
    trials, unreadable = workflows.batch.find_trials(named, runs=True)
    states = [(trial, runner.status(trial)) for trial in trials]
    kinds = [_classify(one) for _, one in states]
    if as_json:
        entries = [
            {"trial": trial.name, "folder": shorten(trial.out), "done": kind == "done", "refused": kind == "refused"}
            | asdict(one)
            for (trial, one), kind in zip(states, kinds, strict=True)
        ]
        entries += [{"trial": None, "file": shorten(file), "failure": str(error)} for file, error in unreadable]
        print_json(entries)
        return
    width = max((len(trial.name) for trial in trials), default=0)
    for trial, one in states:
        typer.echo("\n".join(_describe_status(trial, one, width)))
    for _, error in unreadable:
        typer.echo(str(error))
    counts = Counter(kinds) + Counter({"unreadable": len(unreadable)})
    text = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    typer.echo(f"{count_trials(len(states) + len(unreadable))}: {text}")


def _classify(one: runner.TrialStatus) -> str:
    """Return ``done``, ``to do``, or ``refused`` for a trial that a run would refuse again."""
    return "to do" if not one.done else "refused" if any(stage.state == "refused" for stage in one.stages) else "done"


def _describe_status(trial: Trial, one: runner.TrialStatus, width: int) -> Iterator[str]:
    if one.running:
        yield f"{trial.name:<{width}}  is running at the moment"
    if one.done:
        yield f"{trial.name:<{width}}  {_classify(one)}"
        return
    done = sum(stage.state == "done" for stage in one.stages)
    yield f"{trial.name:<{width}}  {done} of {len(one.stages)} stages done"
    for stage in one.stages:
        if stage.state not in ("done", "waiting"):
            yield f"{'':<{width}}    {stage.stage}: {stage.state}: {stage.why}"
    if one.failure is not None:
        yield f"{'':<{width}}    last run: {one.failure}"


def clean(
    named: TrialFiles,
    *,
    first: Annotated[
        str | None,
        Option(
            "--from",
            metavar="STAGE",
            help="Delete the results from this stage on; keep the results of earlier stages.",
            autocompletion=offer(*STAGE_HELP),
        ),
    ] = None,
    dry_run: Annotated[bool, Option("--dry-run", help="Show what would be deleted, and delete nothing.")] = False,
) -> None:
    """Delete the results of runs.

    Recordings, configurations and all other files are kept.
    """
    if first is not None and first not in STAGE_HELP:
        raise ConfigError(f"--from {first}: there is no such stage, expected one of {', '.join(STAGE_HELP)}")
    for trial in workflows.batch.find_readable_trials(named):
        has_results = Folder(trial.out).is_present()
        if has_results and not dry_run:
            runner.clean(trial, first)
        outcome = ("would be cleaned" if dry_run else "cleaned") if has_results else "has no results"
        typer.echo(f"{trial.name}: {shorten(trial.out)} {outcome}")
