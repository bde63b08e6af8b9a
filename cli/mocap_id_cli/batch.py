"""``mocap-id batch``: many trials, on this machine or on a cluster, and one table of their results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from mocap_id.config.source import read
from mocap_id.errors import ConfigError
from mocap_id.workflows import batch as workflow
from mocap_id.workflows.parallel import Backend, DaskBackend, LocalBackend, OnError
from mocap_id_cli import progress
from mocap_id_cli.console import Quiet, Verbose, log_to_stderr, print_json, short

_SHOWN = 40  # rows; a longer batch shows only the trials that did not succeed


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
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Number of trials at a time on this machine.")] = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Address of a running Dask scheduler, such as tcp://node1:8786."),
    ] = None,
    cluster: Annotated[
        Path | None, typer.Option(metavar="CLUSTER.yaml", help="A cluster for Dask to deploy (SSH, SLURM …).")
    ] = None,
    on_error: Annotated[
        OnError, typer.Option(help="Continue with the other trials when one fails, or stop.")
    ] = "continue",
    out: Annotated[Path, typer.Option(metavar="FILE", help="The table to write.")] = Path("batch.parquet"),
    as_json: Annotated[bool, typer.Option("--json", help="Print the table as JSON.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run many trials and write one table of their results.

    Results that are up to date are reused. If a trial fails or is refused, the others still run and the exit code
    is 1. After an interruption, the same command continues where it stopped.
    """
    log_to_stderr(quiet, verbose)
    if out.suffix != ".parquet":
        raise ConfigError(f"{out}: the table is a Parquet file: choose a name that ends in .parquet")
    found = workflow.run_batch(
        named,
        out,
        backend=_backend(jobs, scheduler, cluster),
        on_error=on_error,
        begin=progress.trial_count(quiet),
        tell=progress.of_trials(quiet),
    )
    progress.stop()
    if as_json:
        print_json(found.rows)
    else:
        typer.echo("\n".join(_lines(found)))
    if found.failed:
        raise typer.Exit(1)


def _backend(jobs: int, scheduler: str | None, cluster: Path | None) -> Backend:
    chosen = [
        name for name, given in (("--jobs", jobs > 1), ("--scheduler", scheduler), ("--cluster", cluster)) if given
    ]
    if len(chosen) > 1:
        raise ConfigError(f"{' and '.join(chosen)}: choose only one of these options")
    if cluster is not None:
        data = read(cluster.absolute()).data
        if not isinstance(data, dict):
            raise ConfigError(f"{cluster}: expected keys such as `kind:` and `workers:`")
        return DaskBackend(cluster=data)
    return LocalBackend(jobs) if scheduler is None else DaskBackend(scheduler)


def _lines(found: workflow.Batch) -> Iterator[str]:
    shown = [
        (number, one) for number, one in enumerate(found.rows) if len(found.rows) <= _SHOWN or one["exit_code"] != 0
    ]
    width = max((len(one["trial"]) for _, one in shown), default=0)
    for number, one in shown:
        yield f"{one['trial']:<{width}}  {_verdict(one)}"
        yield from (f"{'':<{width}}    {line}" for line in found.messages.get(number, "").splitlines())
    counts = Counter(one["verdict"] for one in found.rows)
    total = len(found.rows)
    yield f"{total} trial{'s' * (total != 1)}: " + ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    yield f"table: {short(found.table)}"


def _verdict(one: Mapping[str, Any]) -> str:
    about = f"exit code {one['exit_code']}" if one["verdict"] == "failed" else one["codes"]
    return f"{one['verdict']} ({about})" if about else str(one["verdict"])
