"""``mocap-id batch``: many trials, here or on a cluster, and one table over them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from mocap_id.config.source import read
from mocap_id.errors import ConfigError
from mocap_id.workflows import batch as workflow
from mocap_id.workflows.performing import Dask, Engine, Here, OnError
from mocap_id_cli import progress as live
from mocap_id_cli.run import Quiet, Verbose, log_to_stderr, short
from mocap_id_cli.telling import counting, teller

_SHOWN = 40  # rows; of a longer batch those that did not go through


def batch(
    named: Annotated[
        list[str],
        typer.Argument(
            metavar="STUDY_OR_GLOB...",
            help="Files of trials or studies, folders that hold some, or patterns such as 'lab/*/trial.yaml'.",
            show_default=False,
        ),
    ],
    *,
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Trials at a time on this machine.")] = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Of a Dask scheduler that is running, such as tcp://node1:8786."),
    ] = None,
    cluster: Annotated[
        Path | None, typer.Option(metavar="CLUSTER.yaml", help="A cluster that Dask is to deploy (SSH, SLURM …).")
    ] = None,
    on_error: Annotated[
        OnError, typer.Option(help="Go on with the other trials when one fails, or stop.")
    ] = "continue",
    out: Annotated[Path, typer.Option(metavar="FILE", help="The table.")] = Path("batch.parquet"),
    as_json: Annotated[bool, typer.Option("--json", help="Print the table as JSON.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run many trials and write one table over them; what is up to date is reused.

    A trial that fails or is refused stops no other; the exit code is then 1. After an interruption the same command
    goes on from there.
    """
    log_to_stderr(quiet, verbose)
    if out.suffix != ".parquet":
        raise ConfigError(f"{out}: the table is a Parquet file: give it a name that ends in .parquet")
    found = workflow.run(
        named,
        out,
        engine=_engine(jobs, scheduler, cluster),
        on_error=on_error,
        begin=counting(quiet),
        tell=teller(quiet),
    )
    live.stop()
    if as_json:
        typer.echo(json.dumps(found.rows, indent=2, ensure_ascii=False, allow_nan=False))
    else:
        typer.echo("\n".join(_lines(found)))
    if found.failed:
        raise typer.Exit(1)


def _engine(jobs: int, scheduler: str | None, cluster: Path | None) -> Engine:
    asked = [
        name for name, given in (("--jobs", jobs > 1), ("--scheduler", scheduler), ("--cluster", cluster)) if given
    ]
    if len(asked) > 1:
        raise ConfigError(f"{' and '.join(asked)}: trials are run in one place, choose one of these")
    if cluster is not None:
        data = read(cluster.absolute()).data
        if not isinstance(data, dict):
            raise ConfigError(f"{cluster}: expected keys such as `kind:` and `workers:`")
        return Dask(cluster=data)
    return Here(jobs) if scheduler is None else Dask(scheduler)


def _lines(found: workflow.Batch) -> Iterator[str]:
    told = [
        (number, one) for number, one in enumerate(found.rows) if len(found.rows) <= _SHOWN or one["exit_code"] != 0
    ]
    width = max((len(one["trial"]) for _, one in told), default=0)
    for number, one in told:
        yield f"{one['trial']:<{width}}  {_verdict(one)}"
        yield from (f"{'':<{width}}    {line}" for line in found.messages.get(number, "").splitlines())
    counted = Counter(one["verdict"] for one in found.rows)
    yield f"{len(found.rows)} trials: " + ", ".join(f"{count} {verdict}" for verdict, count in counted.items())
    yield f"table: {short(found.table)}"


def _verdict(one: Mapping[str, Any]) -> str:
    about = f"exit code {one['exit_code']}" if one["verdict"] == "failed" else one["codes"]
    return f"{one['verdict']} ({about})" if about else str(one["verdict"])
