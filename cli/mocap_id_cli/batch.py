"""``mocap-id batch``: runs of many trials, on this machine or on a cluster, with one table of their results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from mocap_id.config.source import read
from mocap_id.errors import ConfigError
from mocap_id.workflows import batch as workflow
from mocap_id.workflows.parallel import Backend, DaskBackend, LocalBackend, OnError
from mocap_id_cli import progress
from mocap_id_cli.console import (
    AsJson,
    Jobs,
    Quiet,
    Verbose,
    count_trials,
    describe_verdict,
    log_to_stderr,
    print_result,
    shorten,
)

_MOST_ROWS = 40  # for more trials, only the trials that did not succeed are printed


def batch(
    named: Annotated[
        list[str],
        typer.Argument(
            metavar="STUDY_OR_GLOB...",
            help="Trial or study files, folders of such files, or patterns such as 'lab/*/trial.yaml'.",
            show_default=False,
        ),
    ],
    *,
    jobs: Jobs = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Address of a running Dask scheduler, such as tcp://node1:8786."),
    ] = None,
    cluster: Annotated[
        Path | None,
        typer.Option(metavar="CLUSTER.yaml", help="Settings of a cluster that Dask should start (SSH, SLURM …)."),
    ] = None,
    on_error: Annotated[
        OnError, typer.Option(help="After a failed trial: continue with the other trials, or stop.")
    ] = "continue",
    out: Annotated[Path, typer.Option(metavar="FILE", help="File for the table, .parquet.")] = Path("batch.parquet"),
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run many trials and write one table of their results.

    Results that are up to date are reused. If a trial fails or is refused, the other trials still run, and the exit
    code is 1. After an interruption, the same command continues where it stopped.
    """
    log_to_stderr(quiet, verbose)
    if out.suffix != ".parquet":
        raise ConfigError(f"{out}: the table is written as a Parquet file: choose a name that ends in .parquet")
    result = workflow.run_batch(
        named,
        out,
        backend=_choose_backend(jobs, scheduler, cluster),
        on_error=on_error,
        begin=progress.show_trial_count(quiet),
        tell=progress.report_trials(quiet),
    )
    progress.stop()
    print_result(as_json, result.rows, _lines(result))
    if result.failed:
        raise typer.Exit(1)


def _choose_backend(jobs: int, scheduler: str | None, cluster: Path | None) -> Backend:
    options = {"--jobs": jobs > 1, "--scheduler": scheduler, "--cluster": cluster}
    chosen = [name for name, given in options.items() if given]
    if len(chosen) > 1:
        raise ConfigError(f"{' and '.join(chosen)}: choose only one of these options")
    if cluster is not None:
        data = read(cluster.absolute()).data
        if not isinstance(data, dict):
            raise ConfigError(f"{cluster}: expected keys such as `kind:` and `workers:`")
        return DaskBackend(cluster=data)
    return LocalBackend(jobs) if scheduler is None else DaskBackend(scheduler)


def _lines(result: workflow.Batch) -> Iterator[str]:
    total = len(result.rows)
    rows = [(k, row) for k, row in enumerate(result.rows) if total <= _MOST_ROWS or row["exit_code"] != 0]
    width = max((len(row["trial"]) for _, row in rows), default=0)
    for number, row in rows:
        yield f"{row['trial']:<{width}}  {describe_verdict(row)}"
        yield from (f"{'':<{width}}    {line}" for line in result.messages.get(number, "").splitlines())
    counts = Counter(row["verdict"] for row in result.rows)
    yield f"{count_trials(total)}: " + ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    yield f"table: {shorten(result.table)}"
