"""The comparison of two runs, and its output as JSON and as a CSV table."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from mocap_id import runner
from mocap_id.errors import ConfigError, StoreError
from mocap_id.store.atomic import write_files
from mocap_id.store.ownership import Owner, check_owner, store_owner
from mocap_id.workflows.compare.difference import Difference
from mocap_id.workflows.compare.origins import compare_artefacts, compare_origins
from mocap_id.workflows.compare.results import compare_results
from mocap_id.workflows.compare.series import compare_series
from mocap_id.workflows.run_folder import SUMMARY, RunFolder, open_run


@dataclass(frozen=True)
class Comparison:
    """Differences between two runs."""

    a: RunFolder
    b: RunFolder
    identical: bool  # whether all artefacts have the same content
    rows: tuple[Difference, ...]  # all compared quantities, including equal ones

    @property
    def changed(self) -> tuple[Difference, ...]:
        """The rows that differ."""
        return tuple(row for row in self.rows if row.differs)


def compare(a: Path, b: Path, progress: runner.Progress = lambda step: None) -> Comparison:
    """Return the comparison of two runs.

    Paths and ``progress`` are as for :func:`mocap_id.workflows.run_folder.open_run`.

    Raises
    ------
    StoreError
        A folder contains no run, a damaged run, or a run without a summary.
    ConfigError, RecordingError, NumericalError
        As for :func:`mocap_id.runner.run`.
    """
    first, second = open_run(a, progress), open_run(b, progress)
    for run in (first, second):
        if not run.summary:
            raise StoreError(f"{run.path / SUMMARY} is missing: run `mocap-id report` on the trial first")
    contents = tuple(compare_artefacts(first, second))
    results = compare_results(first.summary, second.summary)
    rows = (*compare_origins(first, second), *contents, *results, *compare_series(first, second))
    return Comparison(first, second, all(row.a == row.b for row in contents), rows)


def check_format(file: Path) -> None:
    """Raise ConfigError if the file name does not end in .csv."""
    if file.suffix.lower() != ".csv":
        raise ConfigError(f"--out {file}: expected a file name that ends in .csv")


def write(rows: tuple[Difference, ...], file: Path, owner: Owner | None = None) -> None:
    """Write rows to a CSV file; raise StoreError if it cannot be written, or if it is a table of another ``owner``."""
    if owner is not None:
        check_owner(file.parent, owner, file.name)
    columns = list(Difference.__dataclass_fields__)
    text = pd.DataFrame([asdict(row) for row in rows], columns=columns).to_csv(index=False, lineterminator="\n")
    write_files(file.parent, {file.name: text.encode()})
    if owner is not None:
        store_owner(file.parent, owner, file.name)


def as_json(comparison: Comparison, rows: tuple[Difference, ...]) -> dict[str, Any]:
    """Return the comparison with the given rows as JSON values."""
    return {
        "schema": "mocap-id/compare",
        "version": 1,
        "a": {"trial": comparison.a.name, "folder": str(comparison.a.path)},
        "b": {"trial": comparison.b.name, "folder": str(comparison.b.path)},
        "identical": comparison.identical,
        "differences": [asdict(row) for row in rows],
    }
