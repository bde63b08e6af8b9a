"""Running a batch and writing its table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mocap_id.store import Table
from mocap_id.store.atomic import explained, replace_together
from mocap_id.store.parquet import arrow
from mocap_id.workflows.batch.finding import find
from mocap_id.workflows.batch.table import BATCH, row, unreadable_row
from mocap_id.workflows.performing import Engine, Here, OnError, Performed, perform_all
from mocap_id.workflows.study.columns import frame
from mocap_id.workflows.study.writing import parquet


@dataclass(frozen=True)
class Batch:
    """How a batch went.

    Parameters
    ----------
    rows : sequence of mapping
        The table's, in the order of the trials; files that are no trial's at the end.
    messages : mapping
        For whoever has the recordings: row number → why it failed or was refused, files named.
    table : Path
    """

    rows: Sequence[Mapping[str, Any]]
    messages: Mapping[int, str]
    table: Path

    @property
    def failed(self) -> list[int]:
        """Numbers of the rows of trials that did not go through."""
        return [number for number, one in enumerate(self.rows) if one["exit_code"] != 0]


def run(
    named: Sequence[str],
    table: Path,
    *,
    engine: Engine | None = None,
    on_error: OnError = "continue",
    begin: Callable[[int], None] = lambda trials: None,
    tell: Callable[[Performed], None] = lambda done: None,
) -> Batch:
    """Run every trial that is meant and not up to date; a trial that fails stops no other.

    Parameters
    ----------
    named : sequence of str
        As for :func:`mocap_id.workflows.batch.finding.find`.
    table : Path
        Where to write the table, Parquet.
    engine : Engine, optional
        Where trials are run; this process by default.
    on_error : {"continue", "stop"}
    begin : callable, optional
        Told how many trials there are.
    tell : callable, optional
        Told of each trial once it is done.

    Raises
    ------
    ConfigError
        What is named fits nothing, or the engine cannot be had; nothing was run.
    StoreError
        The table cannot be written; nothing was run, or what was run is kept in the trials' folders.
    """
    trials, unreadable = find(named)
    table = table.absolute()
    with explained(table):
        table.parent.mkdir(parents=True, exist_ok=True)
    begin(len(trials))
    performed = perform_all(trials, engine or Here(), tell, on_error)
    rows = [row(trial, done, table.parent) for trial, done in zip(trials, performed, strict=True)]
    messages = {number: done.message for number, done in enumerate(performed) if done.message is not None}
    for one in unreadable:
        messages[len(rows)] = str(one.error)
        rows.append(unreadable_row(one, table.parent))
    whole = arrow(Table.from_frame(BATCH, frame(BATCH, rows)))
    replace_together(table.parent, {table.name: parquet(whole, BATCH, "batch")})
    return Batch(rows, messages, table)
