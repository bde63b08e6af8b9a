"""The table of a batch: one row for each trial, with or without results."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mocap_id.config import Trial
from mocap_id.reporting.results.columns import ResultColumn as Column
from mocap_id.reporting.results.columns import count, number, text, whole
from mocap_id.store import TableSchema
from mocap_id.workflows.batch.named_trials import UnreadableFile
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.trial_outcome import TrialOutcome, read_summary


@dataclass(frozen=True, kw_only=True)
class BatchTrial(TrialOutcome):
    """A trial of a batch, or a file that could not be read as one."""

    file: Path
    out: Path | None
    folder: Path  # of the table

    @property
    def repetitions(self) -> int | None:
        """Number of repetitions found."""
        found = self.value("repetitions")
        return len(found) if isinstance(found, list) else None

    def relative(self, path: Path | None) -> str:
        """Return a path relative to the table's folder; empty for None."""
        try:
            return "" if path is None else os.path.relpath(path, self.folder)
        except ValueError:  # on another drive
            return str(path)


BATCH = TableSchema(
    "batch.parquet",
    1,
    (
        text("trial", "name of the trial", lambda one: one.run.trial),
        text("file", "its YAML file, relative to the table's folder", lambda one: one.relative(one.file)),
        text("folder", "its run folder, relative to the table's folder", lambda one: one.relative(one.out)),
        text("verdict", "ok, caution, refused, failed, or not run because another trial failed", lambda one: one.level),
        text("codes", "codes of the verdict's reasons", lambda one: ", ".join(one.codes)),
        whole("exit_code", "exit code of `mocap-id run` for the trial", lambda one: one.run.exit_code),
        text(
            "message",
            "why the trial failed, was refused or not run, without names of recordings",
            lambda one: one.run.published or "",
        ),
        Column("computed", "bool", "", "whether any stage had to be computed", lambda one: one.run.computed),
        number("seconds", "s", "time that the trial took in this batch", lambda one: one.run.seconds),
        count("segments", "number of segments with the base", lambda one: one.value("segments", "count")),
        number(
            "confidence",
            "1",
            "probability that the segments are right",
            lambda one: one.value("segments", "confidence"),
        ),
        number(
            "missing_fraction",
            "1",
            "share of missing marker samples",
            lambda one: one.value("markers", "missing_fraction"),
        ),
        number(
            "reprojection",
            "m",
            "rms distance between measured and predicted markers",
            lambda one: one.metres("markers", "reprojection_rms_mm"),
        ),
        number(
            "marker_sd", "m", "standard deviation of a marker coordinate", lambda one: one.value("noise", "marker_sd_m")
        ),
        number("mass", "kg", "mass that the plates measure at rest", lambda one: one.value("dynamics", "mass_kg")),
        number(
            "condition_number",
            "1",
            "condition number of the regressor over the samples of the fit",
            lambda one: one.value("dynamics", "condition_number"),
        ),
        number(
            "clock_offset",
            "s",
            "clock offset, plates after cameras",
            lambda one: one.value("dynamics", "clock_offset_s"),
        ),
        number(
            "cop_rms",
            "m",
            "modelled minus measured centre of pressure, rms",
            lambda one: one.value("dynamics", "cop_rms_m"),
        ),
        count("repetitions", "number of repetitions found", lambda one: one.repetitions),
    ),
)


def read_trial(trial: Trial, run: TrialRun, folder: Path) -> BatchTrial:
    """Return a trial of a batch whose table is in a folder."""
    return BatchTrial(run=run, summary=read_summary(trial.out, run), file=trial.file, out=trial.out, folder=folder)


def unreadable_trial(one: UnreadableFile, folder: Path) -> BatchTrial:
    """Return a file that could not be read as a trial, with its error in place of a result."""
    message = str(one.error)
    published = message.replace(str(one.file), one.file.name)
    run = TrialRun(one.file.stem, one.error.exit_code, message, published, None, computed=False, seconds=0.0)
    return BatchTrial(run=run, summary=None, file=one.file, out=None, folder=folder)


def row(trial: BatchTrial) -> dict[str, Any]:
    """Return the known values of a trial's row."""
    values = {
        column.name: column.value(trial) for column in BATCH.columns if isinstance(column, Column) and column.value
    }
    return {name: value for name, value in values.items() if trial.summary is not None or value is not None}
