"""How a trial of a study ended, and the columns that the tables of all studies share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mocap_id.config.study import StudyTrial
from mocap_id.reporting.results.columns import ResultColumn, number, text, whole
from mocap_id.store import Folder
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.trial_outcome import TrialOutcome


@dataclass(frozen=True, kw_only=True)
class StudyOutcome(TrialOutcome):
    """How a trial of a study ended."""

    trial: StudyTrial

    @property
    def name(self) -> str:
        """Name of the trial."""
        return self.trial.name

    @property
    def subject(self) -> str:
        """Id of the person."""
        return self.trial.subject


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
INTERVAL_ENDS = {"": "", "_low": ", lower end of the 95 % interval", "_high": ", upper end of the 95 % interval"}
"""Ends of the column names of :meth:`mocap_id.workflows.study.estimates.Estimate.columns`, and of their meanings."""


def estimate_columns(name: str, unit: str, meaning: str) -> list[ResultColumn]:
    """Return the columns of an estimate without values: itself, and both ends of its interval."""
    return [number(f"{name}{end}", unit, f"{meaning}{words}") for end, words in INTERVAL_ENDS.items()]


def event_facts(trial: StudyTrial, run: TrialRun, protocol: str) -> Mapping[str, Any]:
    """Return the facts of events.parquet about a protocol; empty if the trial failed or was refused."""
    facts = Folder(trial.trial.out).read("events.parquet").facts if run.exit_code == 0 else {}
    return facts.get(protocol) or {}
