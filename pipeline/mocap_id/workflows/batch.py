"""A batch: trials from files, folders, patterns or a study, run in parallel, and one table of their results.

The table has a row for each trial, also for a trial without results.
"""

from __future__ import annotations

import glob
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from mocap_id import plain_files
from mocap_id.config import Trial, load
from mocap_id.config.parsing import Source, read_source
from mocap_id.config.study import load_study
from mocap_id.config.trial import build_trial_model, compose
from mocap_id.errors import ConfigError, StoreError
from mocap_id.reporting.results import ResultColumn as Column
from mocap_id.reporting.results import ResultTable, count, number, text, whole
from mocap_id.store import TableSchema
from mocap_id.store.atomic import converting_errors, write_files
from mocap_id.store.folder import OWNER_FILE, read_owner
from mocap_id.workflows.parallel import Backend, DaskBackend, LocalBackend, OnError, TrialRun, run_trials
from mocap_id.workflows.trial_outcome import SUMMARY_COLUMNS, TrialOutcome, read_entry, read_summary

_TRIAL_FILES = ("*.yaml", "*.yml")
_DESCRIBED_BY = ({"trial", "recording"}, {"trial", "imus"}, {"study", "subjects", "trials"})
"""Keys of which a file with trials has all of one set."""


def find_trials(named: Sequence[str], *, runs: bool = False) -> tuple[list[Trial], list[tuple[Path, ConfigError]]]:
    """Return the named trials, each once, and the files that cannot be read as trials, with the error.

    The names are files of trials or studies; folders with such files at any depth; patterns such as
    ``lab/*/trial.yaml`` (``**`` matches folders at any depth). If ``runs``, a folder also stands for the trials whose
    run folders it contains; their files may be elsewhere. ConfigError is raised if a name matches nothing, or if two
    trials have the same run folder.
    """
    trials: dict[Path, Trial] = {}
    unreadable: list[tuple[Path, ConfigError]] = []
    model = build_trial_model()  # once, because making it takes as long as reading a file
    for file, source in dict(one for name in named for one in _find_files(name, runs)).items():
        try:
            content = read_source(file) if source is None else source
            if not isinstance(content.data, dict):
                found = [load(file)]  # raises ConfigError with a message about the content
            elif "study" in content.data:
                found = [one.trial for one in load_study(file).trials]
            else:
                found = [compose(content, model=model)]
        except ConfigError as error:
            unreadable.append((file, error))
            continue
        for trial in found:
            other = trials.setdefault(trial.out.resolve(), trial)
            if (other.file.resolve(), other.name) != (trial.file.resolve(), trial.name):
                raise ConfigError(
                    f"{trial.file} and {other.file} share the folder {trial.out}: give one of them a different `out:`"
                )
    return list(trials.values()), unreadable


def find_readable_trials(named: Sequence[str]) -> list[Trial]:
    """Return the trials that :func:`find_trials` finds; raise ConfigError if a file cannot be read as a trial."""
    trials, unreadable = find_trials(named)
    if unreadable:
        raise ConfigError("\n".join(str(error) for _, error in unreadable))
    return trials


def _find_files(name: str, runs: bool) -> Iterator[tuple[Path, Source | None]]:
    """Yield the absolute path of each file that matches a name, and its content if it was read, else None."""
    path = Path(name).expanduser()
    files: dict[Path, Source | None]
    if path.is_dir():
        files = {}
        for file in sorted(file for pattern in _TRIAL_FILES for file in path.absolute().rglob(pattern)):
            # The files that describe trials, and unreadable files that are named ``trial``.
            try:
                source = read_source(file)
            except ConfigError:
                if file.stem == "trial":
                    files[file] = None
                continue
            keys = source.data.keys() if isinstance(source.data, dict) else set()
            if any(needed <= keys for needed in _DESCRIBED_BY):
                files[file] = source
        known = {file.resolve() for file in files}
        for record in sorted(path.absolute().rglob(OWNER_FILE)) if runs else ():
            owner = read_owner(record.parents[1])
            if owner is not None and owner.file not in known:
                files |= {owner.file: None}
    elif path.exists() or not glob.has_magic(name):
        files = {path.absolute(): None}
    else:
        matches = sorted(glob.glob(str(path), recursive=True))  # noqa: PTH207  the pattern may be absolute
        files = dict.fromkeys(Path(file).absolute() for file in matches)
    if not files:
        what = "this folder contains no trial's YAML file" if path.is_dir() else "no file has this name"
        raise ConfigError(
            f"{name}: {what}; expected a trial's or a study's YAML file, a folder of them, or a pattern"
            f"{plain_files.suggest(path)}"
        )
    yield from files.items()


_log = logging.getLogger(__name__)


def _count_repetitions(trial: TrialOutcome) -> int | None:
    repetitions = trial.value("repetitions")
    return len(repetitions) if isinstance(repetitions, list) else None


BATCH = TableSchema(
    "batch.parquet",
    1,
    (
        text("trial", "name of the trial", lambda one: one.run.trial),
        text("file", "its YAML file, relative to the table's folder"),
        text("folder", "its run folder, relative to the table's folder"),
        text("verdict", "ok, caution, refused, failed, or not run because another trial failed", lambda one: one.level),
        text("codes", "codes of the verdict's reasons", lambda one: ", ".join(one.codes)),
        whole("exit_code", "exit code of `mocap-id run` for the trial", lambda one: one.run.exit_code),
        text(
            "message",
            "why the trial failed, was refused or was not run, without names of recordings",
            lambda one: one.run.published or "",
        ),
        Column("computed", "bool", "", "whether any stage had to be computed", lambda one: one.run.computed),
        number("seconds", "s", "time that the trial took in this batch", lambda one: one.run.seconds),
        *(SUMMARY_COLUMNS[name] for name in ("segments", "confidence", "missing_fraction", "reprojection")),
        number("marker_sd", "m", "standard deviation of a marker coordinate", read_entry("noise", "marker_sd_m")),
        *(SUMMARY_COLUMNS[name] for name in ("mass", "condition_number", "clock_offset")),
        number("cop_rms", "m", "modelled minus measured centre of pressure, rms", read_entry("dynamics", "cop_rms_m")),
        count("repetitions", "number of repetitions found", _count_repetitions),
    ),
)
"""Schema of the table of a batch."""


@dataclass(frozen=True)
class Batch:
    """The result of a batch."""

    # rows of the table in the order of the trials, followed by the files that could not be read as trials
    rows: Sequence[Mapping[str, Any]]
    # why a trial failed or was refused, by row number; for the owner of the recordings only, because it may name files
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
    """Run all trials that are not up to date, and write one Parquet ``table`` of all trials.

    ``named`` is as for :func:`find_trials`. Trials run in this process by default, and always if there is only one.
    With ``on_error="stop"``, no trial starts after one that failed or was refused. ``begin`` is called with the number
    of trials before the first trial runs, and ``tell`` with each finished trial.

    Raises
    ------
    ConfigError
        A name matches nothing, two trials have the same run folder, or the backend is not available. No trial was run.
    StoreError
        The table cannot be written, and the results of the trials remain in their run folders; or the file is a table
        of other trials, or of another kind, and no trial was run.
    """
    trials, unreadable = find_trials(named)
    table = table.absolute()
    if table.exists():
        # Only the table of a batch with at least one of the trials is replaced.
        try:
            rows = pq.read_table(table, columns=["trial", "file", "folder"]).to_pylist()
            before = {(table.parent / row[key]).resolve() for row in rows for key in ("file", "folder") if row[key]}
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise StoreError(
                f"{table} exists and is not a table of `mocap-id batch`: choose another file with `--out`"
            ) from error
        now = {path.resolve() for trial in trials for path in (trial.file, trial.out)}
        if trials and before and not before & now:
            named_files = []
            for files in ((row["file"] for row in rows), (trial.file for trial in trials)):
                names = [os.path.relpath(table.parent / file, table.parent) for file in dict.fromkeys(files)]
                named_files.append(", ".join(names[:3]) + (" …" if names[3:] else ""))
            others, own = named_files
            raise StoreError(
                f"{table} is the table of other trials ({others}), and the table of this batch ({own}) would replace "
                "it: choose another file with `--out`"
            )
    with converting_errors(table):
        table.parent.mkdir(parents=True, exist_ok=True)
    if len(trials) == 1 and isinstance(backend, DaskBackend):
        _log.warning("there is only one trial: it runs on this machine, without Dask")
    begin(len(trials))
    runs = run_trials(trials, backend or LocalBackend(), tell, on_error)
    messages = {k: run.message for k, run in enumerate(runs) if run.message is not None}
    rows = [
        make_row(TrialOutcome(run=run, summary=read_summary(one.out, run)), one.file, one.out, table.parent)
        for one, run in zip(trials, runs, strict=True)
    ]
    for file, wrong in unreadable:  # the error takes the place of a result
        messages[len(rows)] = str(wrong)
        published = str(wrong).replace(str(file), file.name)
        run = TrialRun(file.stem, wrong.exit_code, str(wrong), published, None, computed=False, seconds=0.0)
        rows.append(make_row(TrialOutcome(run=run, summary=None), file, None, table.parent))
    write_files(table.parent, {table.name: ResultTable.of(BATCH, rows).parquet("batch")})
    return Batch(rows, messages, table)


def make_row(trial: TrialOutcome, file: Path, out: Path | None, folder: Path) -> dict[str, Any]:
    """Return the row of a trial in the table in a folder; without a summary, it has only the known values.

    ``file`` is the trial's file, and ``out`` its run folder, None for a file that could not be read.
    """

    def relative(path: Path | None) -> str:
        try:
            return "" if path is None else os.path.relpath(path, folder)
        except ValueError:  # on another drive
            return str(path)

    values = {"file": relative(file), "folder": relative(out)}
    row = {
        column.name: values[column.name] if column.value is None else column.value(trial)
        for column in BATCH.columns
        if isinstance(column, Column)
    }
    return {name: value for name, value in row.items() if trial.summary is not None or value is not None}
