"""All that ``mocap-id compare`` does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mocap_id import runner
from mocap_id.errors import StoreError
from mocap_id.workflows.compare.difference import Difference, changed
from mocap_id.workflows.compare.origins import artefacts, origins
from mocap_id.workflows.compare.results import results
from mocap_id.workflows.compare.series import series
from mocap_id.workflows.run_folder import SUMMARY, RunFolder, open_run


@dataclass(frozen=True)
class Comparison:
    """Two runs held against each other.

    Parameters
    ----------
    a, b : RunFolder
    identical : bool
        Every artefact of the one holds the same content as the other's.
    rows : tuple of Difference
        All that was compared.
    """

    a: RunFolder
    b: RunFolder
    identical: bool
    rows: tuple[Difference, ...]

    @property
    def changed(self) -> tuple[Difference, ...]:
        """What differs."""
        return changed(self.rows)


def compare(a: Path, b: Path, progress: runner.Progress = lambda step: None) -> Comparison:
    """Hold one run against another.

    Parameters
    ----------
    a, b : Path
        Each as for :func:`mocap_id.workflows.run_folder.open_run`.
    progress : callable, optional
        Told of every stage of a YAML file.

    Raises
    ------
    StoreError
        A folder holds no run, a damaged one, or none with a summary.
    ConfigError, RecordingError, NumericalError
        As for :func:`mocap_id.runner.run`.
    """
    first, second = open_run(a, progress), open_run(b, progress)
    for run in (first, second):
        if not run.summary:
            raise StoreError(f"{run.path / SUMMARY} is missing: run `mocap-id report` on the trial first")
    contents = tuple(artefacts(first, second))
    rows = (*origins(first, second), *contents, *results(first.summary, second.summary), *series(first, second))
    return Comparison(first, second, all(row.a == row.b for row in contents), rows)
