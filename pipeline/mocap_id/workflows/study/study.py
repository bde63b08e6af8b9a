"""``mocap-id study``: run every trial, then make the tables and the page of the cohort, unless they are up to date."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from mocap_id import __version__
from mocap_id.config.study import Study, load_study
from mocap_id.reporting.cohort.material import PAGE_FILE, CohortMaterial, TrialEntry
from mocap_id.reporting.shape import ReasonEntry
from mocap_id.store import Folder, dumps, hash_bytes, hash_file
from mocap_id.store.atomic import replace_together
from mocap_id.workflows.performing import Here, Performed, Tell, perform_all
from mocap_id.workflows.study import (
    lengths_table,
    models_table,
    parameters_table,
    strategies_table,
    trials_table,
    variation_table,
    writing,
)
from mocap_id.workflows.study.cases import Case, case
from mocap_id.workflows.study.columns import TABLES, frame

_VERSION = 3  # raised whenever the same trials would give other tables or another page
_ROWS: Mapping[str, Callable[[Sequence[Case]], Any]] = {
    "trials": trials_table.rows,
    "lengths": lengths_table.rows,
    "strategies": strategies_table.rows,
    "models": models_table.rows,
    "parameters": parameters_table.rows,
    "variation": variation_table.rows,
}


@dataclass(frozen=True)
class Outcome:
    """How a study went.

    Parameters
    ----------
    study : Study
    performed : tuple of Performed
        Its trials.
    document : mapping
        What study.json holds.
    reused : bool
        Tables and page were up to date.
    """

    study: Study
    performed: tuple[Performed, ...]
    document: Mapping[str, Any]
    reused: bool

    @property
    def failed(self) -> tuple[Performed, ...]:
        """Trials that failed or were refused."""
        return tuple(one for one in self.performed if one.exit_code != 0)

    @property
    def page(self) -> Path:
        """The cohort's page."""
        return self.study.folder / PAGE_FILE


def run(
    file: Path,
    jobs: int = 1,
    begin: Callable[[int], None] = lambda trials: None,
    tell: Tell = lambda done: None,
) -> Outcome:
    """Run a study.

    Parameters
    ----------
    file : Path
        Its YAML file.
    jobs : int
        Trials at a time.
    begin : callable, optional
        Told how many trials there are.
    tell : callable, optional
        Told of every trial once it is done.

    Raises
    ------
    ConfigError
        The file is wrong; nothing was run.
    StoreError
        The study's folder is in use or cannot be written. What goes wrong with one trial is told in its row.
    """
    study = load_study(file)
    folder = Folder(study.folder)
    with folder.locked():
        begin(len(study.trials))
        performed = perform_all([one.trial for one in study.trials], Here(jobs), tell)
        key = _key(study, performed)
        standing = _standing(study.folder, key)
        if standing is not None:
            return Outcome(study, performed, standing, reused=True)
        cases = [case(study, one, done) for one, done in zip(study.trials, performed, strict=True)]
        frames = tables(cases)
        files = {**writing.table_files(frames), **_documents(study, cases, frames)}
        document = writing.document(study, cases, frames, files, key)
        replace_together(study.folder, {**files, writing.DOCUMENT: writing.as_bytes(document)})
    return Outcome(study, performed, document, reused=False)


def tables(cases: Sequence[Case]) -> dict[str, pd.DataFrame]:
    """Every table of :data:`mocap_id.workflows.study.columns.TABLES`."""
    return {name: frame(schema, _ROWS[name](cases)) for name, schema in TABLES.items()}


def _documents(study: Study, cases: Sequence[Case], frames: Mapping[str, pd.DataFrame]) -> dict[str, bytes]:
    from mocap_id.reporting.cohort.page import page  # noqa: PLC0415  templates are imported by whoever writes a page

    return {PAGE_FILE: page(CohortMaterial(study.name, __version__, tuple(map(_entry, cases)), frames))}


def _entry(case: Case) -> TrialEntry:
    return TrialEntry(
        name=case.trial.name,
        subject=case.subject,
        strategy=case.strategy,
        fate=trials_table.level(case),
        reasons=[] if case.summary is None else [ReasonEntry(**one) for one in case.summary["verdict"]["reasons"]],
        message=case.performed.published,
        report=writing.report_of(case),
    )


def _key(study: Study, performed: Sequence[Performed]) -> str:
    """Changes with whatever tables and page depend on: what the trials' reports tell, the people, the file's words."""
    trials = [
        [one.name, one.subject, one.strategy, done.exit_code, done.published, done.key]
        for one, done in zip(study.trials, performed, strict=True)
    ]
    people = {name: person.model_dump(mode="json") for name, person in study.subjects.items()}
    return hash_bytes(dumps([_VERSION, __version__, study.name, trials, people]).encode())


def _standing(folder: Path, key: str) -> Mapping[str, Any] | None:
    """study.json, if it and all that it names are what would be written now."""
    try:
        document: Mapping[str, Any] = json.loads((folder / writing.DOCUMENT).read_text("utf-8"))
        sound = all(hash_file(folder / file) == content for file, content in document["files"].items())
        return document if sound and document["key"] == key else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None  # nothing there, or nothing that can be trusted: it is made anew
