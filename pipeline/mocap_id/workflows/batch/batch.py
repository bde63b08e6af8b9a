"""Running a batch and writing its table."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mocap_id.reporting.results.columns import ResultTable
from mocap_id.store.atomic import converting_errors, write_files
from mocap_id.workflows.batch.named_trials import find_trials
from mocap_id.workflows.batch.table import BATCH, read_trial, row, unreadable_trial
from mocap_id.workflows.parallel import Backend, DaskBackend, LocalBackend, OnError, TrialRun, run_trials

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Batch:
    """The result of a batch."""

    # rows of the table in the order of the trials, followed by the files that could not be read as trials
    rows: Sequence[Mapping[str, Any]]
    # row number → why the trial failed or was refused, with names of files, for the owner of the recordings
    messages: Mapping[int, str]
    table: Path

    @property
    def failed(self) -> list[int]:
        """Row numbers of the trials without results."""
        return [number for number, one in enumerate(self.rows) if one["exit_code"] != 0]


def run_batch(
    named: Sequence[str],
    table: Path,
    *,
    backend: Backend | None = None,
    on_error: OnError = "continue",
    begin: Callable[[int], None] = lambda trials: None,
    tell: Callable[[TrialRun], None] = lambda run: None,
) -> Batch:
    """Run all trials that are not up to date; a failed trial stops no other.

    Parameters
    ----------
    named : sequence of str
        As for :func:`mocap_id.workflows.batch.named_trials.find_trials`.
    table : Path
        Parquet file of the table.
    backend : Backend, optional
        Where trials run; this process by default, and always for a single trial.
    on_error : {"continue", "stop"}
    begin : callable, optional
        Called with the number of trials before the first one runs.
    tell : callable, optional
        Called with each trial that ends.

    Raises
    ------
    ConfigError
        A name matches nothing, or the backend is not available; nothing was run.
    StoreError
        The table cannot be written; trials that did run are kept in their folders.
    """
    trials, unreadable = find_trials(named)
    table = table.absolute()
    with converting_errors(table):
        table.parent.mkdir(parents=True, exist_ok=True)
    if len(trials) == 1 and isinstance(backend, DaskBackend):
        _log.warning("there is only one trial: it runs on this machine, without Dask")
    begin(len(trials))
    runs = run_trials(trials, backend or LocalBackend(), tell, on_error)
    rows = [row(read_trial(trial, run, table.parent)) for trial, run in zip(trials, runs, strict=True)]
    messages = {number: run.message for number, run in enumerate(runs) if run.message is not None}
    for number, one in enumerate(unreadable, start=len(rows)):
        messages[number] = str(one.error)
        rows.append(row(unreadable_trial(one, table.parent)))
    write_files(table.parent, {table.name: ResultTable.of(BATCH, rows).parquet("batch")})
    return Batch(rows, messages, table)
