"""The outcome of a trial's run, and the columns and tables that batches and studies make from outcomes."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mocap_id.errors import Refused
from mocap_id.reporting import ENDINGS, SUMMARY_FILE
from mocap_id.reporting.grids import to_number
from mocap_id.reporting.results import ResultColumn, count, number, text, whole
from mocap_id.reporting.summary_schema import ReasonEntry
from mocap_id.workflows.parallel import NOT_RUN, TrialRun

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from mocap_id.config.study import StudyTrial
    from mocap_id.reporting.study import TrialEntry


@dataclass(frozen=True, kw_only=True)
class TrialOutcome:
    """The outcome of a trial's run."""

    run: TrialRun
    summary: Mapping[str, Any] | None  # content of summary.json; None for a trial that failed or was not run

    @property
    def level(self) -> Any:
        """Level of the verdict; ``failed`` or ``not run`` if there is no verdict."""
        if self.summary is not None:
            return self.summary["verdict"]["level"]
        return "not run" if self.run.exit_code == NOT_RUN else "failed"

    @property
    def codes(self) -> list[str]:
        return [str(reason["code"]) for reason in self.value("verdict", "reasons") or ()]

    def value(self, *keys: str) -> Any:
        """Return an entry of the summary by its keys, from the outermost key; None if there is no such entry."""
        return find_entry(self.summary, *keys)

    def metres(self, *keys: str) -> float | None:
        """Return an entry of the summary, converted from millimetres to metres; None if there is no such entry."""
        value = self.value(*keys)
        return None if value is None else value / 1e3

    def entry(self, name: str, about: str, report: str) -> TrialEntry:
        """Return the entry of the trial on a page; `report` is the path of its report, unused for a failed trial."""
        from mocap_id.reporting.study import TrialEntry  # noqa: PLC0415  only a page needs it

        reasons = [ReasonEntry(**reason) for reason in self.value("verdict", "reasons") or ()]
        link = None if self.summary is None else report
        return TrialEntry(name, about, self.level, reasons, self.run.published, link)


@dataclass(frozen=True, kw_only=True)
class StudyOutcome(TrialOutcome):
    """The outcome of a trial of a study."""

    trial: StudyTrial

    @property
    def name(self) -> str:
        return self.trial.name

    @property
    def subject(self) -> str:
        return self.trial.subject


def read_summary(folder: Path, run: TrialRun) -> Mapping[str, Any] | None:
    """Return the content of summary.json; None for a failed trial, because its file may be from an earlier run."""
    if run.exit_code not in (0, Refused.exit_code):
        return None
    summary: Mapping[str, Any] = json.loads((folder / SUMMARY_FILE).read_text("utf-8"))
    return summary


def find_entry(entry: Any, *keys: str) -> Any:
    """Return an entry of nested mappings by its keys, from the outermost key; None if there is no such entry."""
    for key in keys:
        entry = (entry or {}).get(key)
    return entry


def number_or_nan(value: object) -> float:
    """Return a fact as a number; NaN if it is missing or not finite."""
    known = to_number(value)
    return math.nan if known is None else known


def read_entry(*keys: str) -> Callable[[TrialOutcome], Any]:
    """Return a function that reads an entry of a trial's summary, for a column of a table."""
    return lambda trial: trial.value(*keys)


SUMMARY_COLUMNS: Mapping[str, ResultColumn] = {
    column.name: column
    for column in (
        count("segments", "number of segments with the base", read_entry("segments", "count")),
        number("confidence", "1", "probability that the segments are right", read_entry("segments", "confidence")),
        number(
            "missing_fraction", "1", "fraction of missing marker samples", read_entry("markers", "missing_fraction")
        ),
        number(
            "reprojection",
            "m",
            "rms distance between measured and predicted markers",
            lambda trial: trial.metres("markers", "reprojection_rms_mm"),
            "re-projection (mm)",
            decimals=1,
            factor=1e3,
            optional=True,
        ),
        number("mass", "kg", "mass that the plates measure while the person stands", read_entry("dynamics", "mass_kg")),
        number(
            "condition_number",
            "1",
            "condition number of the chain's regressor (base parameters) over the samples of the fit",
            read_entry("dynamics", "condition_number"),
            "condition number",
            optional=True,
        ),
        number("clock_offset", "s", "clock offset, plates after cameras", read_entry("dynamics", "clock_offset_s")),
    )
}
"""Columns that are the same in the tables of batches and studies, by name."""
TRIAL_COLUMNS: tuple[ResultColumn, ...] = (
    text("trial", "name of the trial and of its run folder", lambda trial: trial.name, "trial"),
    text("subject", "id of the person", lambda trial: trial.subject, "person"),
)
VERDICT_COLUMNS: tuple[ResultColumn, ...] = (
    text(
        "verdict",
        "ok, caution, refused, or failed without a verdict",
        lambda trial: trial.level,
        "verdict",
        cell=lambda row: ENDINGS[row["verdict"]],
    ),
    text("codes", "codes of the verdict's reasons", lambda trial: ", ".join(trial.codes)),
    whole("exit_code", "exit code of `mocap-id run` for the trial", lambda trial: trial.run.exit_code),
    text("message", "why the trial failed or was refused, without names of files", lambda trial: trial.run.published),
)
