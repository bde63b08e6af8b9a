"""Definitions for all kinds of studies: the outcome of a trial, measures, and columns of tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from mocap_id.config.study import StudyTrial
from mocap_id.reporting.results.columns import ResultColumn, ResultTable, number, text, whole
from mocap_id.store import Folder, TableSchema
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.trial_outcome import TrialOutcome

Trial = TypeVar("Trial")
Value = TypeVar("Value")


@dataclass(frozen=True, kw_only=True)
class StudyOutcome(TrialOutcome):
    """The outcome of a trial of a study."""

    trial: StudyTrial

    @property
    def name(self) -> str:
        """Name of the trial."""
        return self.trial.name

    @property
    def subject(self) -> str:
        """Id of the person."""
        return self.trial.subject


@dataclass(frozen=True)
class Measure(Generic[Trial, Value]):
    """A quantity that a study compares between people or conditions."""

    unit: str
    meaning: str
    of: Callable[[Trial], Value]  # returns the quantity of a trial


TRIAL_COLUMNS: tuple[ResultColumn, ...] = (
    text("trial", "name of the trial and of its run folder", lambda trial: trial.name),
    text("subject", "id of the person", lambda trial: trial.subject),
)
VERDICT_COLUMNS: tuple[ResultColumn, ...] = (
    text("verdict", "ok, caution, refused, or failed without a verdict", lambda trial: trial.level),
    text("codes", "codes of the verdict's reasons", lambda trial: ", ".join(trial.codes)),
    whole("exit_code", "exit code of `mocap-id run` for the trial", lambda trial: trial.run.exit_code),
    text("message", "why the trial failed or was refused, without names of files", lambda trial: trial.run.published),
)
_INTERVAL_ENDS = {"": "", "low": ", lower end of the 95 % interval", "high": ", upper end of the 95 % interval"}


def estimate_columns(
    name: str, unit: str, meaning: str, estimate: Callable[[Any], Any] | None = None
) -> list[ResultColumn]:
    """Return the columns of an estimate: its value, and both ends of its 95 % interval.

    Parameters
    ----------
    name, unit, meaning : str
    estimate : callable, optional
        Returns the estimate of a trial; by default, the rows contain the values by column name.
    """
    return [
        number(f"{name}_{end}" if end else name, unit, f"{meaning}{words}", _part_of(estimate, end or "value"))
        for end, words in _INTERVAL_ENDS.items()
    ]


def _part_of(estimate: Callable[[Any], Any] | None, part: str) -> Callable[[Any], float] | None:
    return None if estimate is None else lambda trial: getattr(estimate(trial), part)


def fill_tables(
    schemas: Mapping[str, TableSchema],
    rows: Mapping[str, Callable[[Sequence[Any]], Iterable[Any]]],
    trials: Sequence[Any],
) -> dict[str, ResultTable]:
    """Return the tables of a study by name; a table without a function in ``rows`` has a row for each trial."""
    return {
        name: ResultTable.of(schema, rows[name](trials) if name in rows else trials) for name, schema in schemas.items()
    }


def read_event_facts(trial: StudyTrial, run: TrialRun, protocol: str) -> Mapping[str, Any]:
    """Return the facts of events.parquet about a protocol; empty if missing, or if the trial failed or was refused."""
    facts = Folder(trial.trial.out).read("events.parquet").facts if run.exit_code == 0 else {}
    return facts.get(protocol) or {}
