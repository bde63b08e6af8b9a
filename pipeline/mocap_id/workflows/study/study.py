"""``mocap-id study``: run every trial, then write the tables and the page of the cohort unless they are up to date."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap_id import __version__
from mocap_id.config import Trial
from mocap_id.config.study import Study, load_study
from mocap_id.reporting.contents import COHORT_PAGE
from mocap_id.reporting.results.columns import ResultTable
from mocap_id.reporting.results.result import Result
from mocap_id.stages import STAGES
from mocap_id.stages.trial_keys import list_sensors
from mocap_id.store import Folder, TableSchema, dumps, hash_bytes, hash_file
from mocap_id.store.ownership import Owner, check_owner, hash_texts, store_owner
from mocap_id.workflows.parallel import LocalBackend, TrialCallback, TrialRun, run_trials
from mocap_id.workflows.study.segment_numbers import run_with_counts
from mocap_id.workflows.trial_outcome import TrialOutcome

if TYPE_CHECKING:
    from mocap_id.reporting.study.cohort import CohortData

DOCUMENT = "study.json"
_SAME_MASS, _SAME_LENGTH = 0.10, 0.12  # largest relative differences between two trials of one person
_SURE = 4.0  # standard deviations by which two lengths of different people differ
_VERSION = 5  # raised whenever the same trials would give other tables or another page
_ABOUT = (
    "Each table is a CSV and a Parquet file (units and meanings in the field metadata). A row with the subject "
    "`cohort` is about all people. A missing value is empty in CSV and NaN in Parquet."
)


@dataclass(frozen=True)
class StudyKind:
    """A kind of study: what is read from a trial, and what the tables and the page make of it."""

    labels: tuple[str, ...]  # names of the properties that distinguish the trials of a person
    read: Callable[[Any, Any, TrialRun], Any]  # reads the result of a trial, a `TrialOutcome`, of a study
    tables: Mapping[str, TableSchema]  # columns of the tables by name
    # Functions that pool the trials to the rows of a table; a table without a function has a row for each trial.
    rows: Mapping[str, Callable[[Sequence[Any]], Iterable[Any]]]
    page: Callable[[CohortData, Sequence[Any]], bytes]  # makes the page
    prepare: Callable[[Sequence[Any]], Sequence[Any]] = list  # completes the results by those of other trials

    def read_labels(self, trial: Any) -> dict[str, Any]:
        """Return the properties of a trial by name."""
        return {name: getattr(trial, name) for name in self.labels}

    def make_tables(self, trials: Sequence[Any]) -> dict[str, ResultTable]:
        """Return the tables by name."""
        own = self.prepare(trials)
        return {name: ResultTable.of(table, self.rows.get(name, list)(own)) for name, table in self.tables.items()}


@dataclass(frozen=True)
class StudyResult:
    """The result of a study."""

    study: Study
    runs: tuple[TrialRun, ...]  # how each trial ended
    document: Mapping[str, Any]  # content of study.json
    reused: bool  # whether tables and page were up to date

    @property
    def failed(self) -> tuple[TrialRun, ...]:
        """Trials that failed or were refused."""
        return tuple(run for run in self.runs if run.exit_code != 0)

    @property
    def page(self) -> Path:
        """Path of the page of the cohort."""
        return self.study.folder / COHORT_PAGE


def run_study(
    file: Path,
    jobs: int = 1,
    begin: Callable[[int], None] = lambda trials: None,
    tell: TrialCallback = lambda run: None,
) -> StudyResult:
    """Run all trials of a study, write its tables and page, and return the result.

    Parameters
    ----------
    file : Path
        The study's YAML file.
    jobs : int
        Number of trials that run at the same time.
    begin : callable, optional
        Called with the number of trials before the first trial runs.
    tell : callable, optional
        Called with the result of each finished trial.

    Raises
    ------
    ConfigError
        The file is wrong; no trial was run.
    StoreError
        The study's folder is in use, cannot be written, or belongs to another study. The failure of a trial raises
        nothing; it is in the tables.
    """
    study = load_study(file)
    owner = _find_owner(study)
    with Folder(study.folder).locked():
        check_owner(study.folder, owner, DOCUMENT)
        begin(len(study.trials))
        told: set[str] = set()

        def tell_once(done: TrialRun) -> None:
            if done.trial not in told:
                told.add(done.trial)
                tell(done)

        def run(trials: list[Trial]) -> tuple[TrialRun, ...]:
            return run_trials(trials, LocalBackend(jobs), tell_once)

        before = _read_document(study.folder)
        counts, remarks = dict[str, Any](), list[str]()
        if study.curl or study.reach:  # the segments of an arm have names
            runs = run([one.trial for one in study.trials])
        else:
            known = before.get("segments")
            runs, counts, remarks = run_with_counts(study.trials, known if isinstance(known, dict) else {}, run)
        key = _hash_content(study, runs)
        is_current = before.get("key") == key and _is_unchanged(study.folder, before)
        store_owner(study.folder, owner, DOCUMENT)
        if is_current:
            return StudyResult(study, runs, before, reused=True)
        result = _make_result(study, runs, key, counts, remarks)
        result.write(study.folder)
    return StudyResult(study, runs, result.document, reused=False)


def _find_owner(study: Study) -> Owner:
    """Return the owner of the study's tables: its name with one of its recordings is enough to know it again."""
    contents = []
    for one in study.trials:
        keys = one.trial.keys
        files = (
            [each.file for each in list_sensors(keys.imus).values()]
            if keys.recording is None
            else [keys.recording.motion]
        )
        place = [os.path.relpath(file, study.file.parent) for file in files]
        contents.append(hash_texts([study.name, one.name, *place]))
    return Owner(study.name, study.file, tuple(contents))


def find_same_recordings(study: Study) -> Iterator[tuple[str, str]]:
    """Yield the names of two finished trials that used the same time window of files with the same content."""
    first_trials: dict[Any, str] = {}
    for one in study.trials:
        origin = Folder(one.trial.out).origin(STAGES[0].name, STAGES[0].outputs)
        if origin is None:
            continue
        hashes = frozenset(each for role, each in origin.inputs.items() if role.startswith("recording"))
        if hashes:
            content = (hashes, str(origin.parameters.get("window")))
            if content in first_trials:
                yield first_trials[content], one.name
            first_trials.setdefault(content, one.name)


def find_remarks(study: Study, trials: Sequence[TrialOutcome]) -> Iterator[str]:
    """Yield sentences about trials that may be of another person than their id says.

    Two trials of one id differ in mass or segment length more than one person's trials do, or two trials have the same
    recording. ``trials`` are the outcomes in the order of the study.
    """
    for first, second in find_same_recordings(study):
        yield f"the trials {first} and {second} have the same recording; one file is probably a copy"
    for subject in study.subjects:
        own = [(one.name, trial) for one, trial in zip(study.trials, trials, strict=True) if one.subject == subject]
        masses = [(float(mass), 0.0, name) for name, trial in own if (mass := trial.value("dynamics", "mass_kg"))]
        found = [("the mass", "kg", masses, _SAME_MASS)]
        for segment in dict.fromkeys(segment for _, trial in own for segment in trial.value("lengths_m") or ()):
            lengths = [(trial.value("lengths_m", segment), name) for name, trial in own]
            known = [(float(each["value"]), float(each["sd"] or 0.0), name) for each, name in lengths if each]
            found.append((f"the length of the {segment.replace('_', ' ')}", "m", known, _SAME_LENGTH))
        for what, unit, values, limit in found:
            (low, low_sd, first), (high, high_sd, second) = min(values, default=_NONE), max(values, default=_NONE)
            if high - low > max(limit * (high + low) / 2, _SURE * math.hypot(low_sd, high_sd)):
                yield (
                    f"{subject} may be two people: {what} is {low:.3g} {unit} in {first} and {high:.3g} {unit} in "
                    f"{second}. Check the ids of these trials; the numbers of {subject} are means over both"
                )
                break


_NONE = (0.0, 0.0, "")


def _make_result(
    study: Study, runs: Sequence[TrialRun], key: str, counts: Mapping[str, Any], notes: Sequence[str]
) -> Result:
    # The modules of the other kinds are not imported.
    name = "curls" if study.curl else "reach" if study.reach else "sit_to_stand"
    kind: StudyKind = import_module(f"mocap_id.workflows.study.{name}").STUDY
    trials = [kind.read(study, one, run) for one, run in zip(study.trials, runs, strict=True)]
    labels = [kind.read_labels(trial) for trial in trials]
    remarks = (*notes, *find_remarks(study, trials))
    tables = kind.make_tables(trials)

    def make_page() -> dict[str, bytes]:
        from mocap_id.reporting.study.cohort import CohortData  # noqa: PLC0415  only a page needs it

        entries = tuple(
            one.entry(one.name, ", ".join(filter(None, [one.subject, *own.values()])), f"../{one.name}/report.html")
            for one, own in zip(trials, labels, strict=True)
        )
        return {COHORT_PAGE: kind.page(CohortData(study.name, entries, tables, remarks), trials)}

    content = {
        "study": study.name,
        "product": __version__,
        "about": _ABOUT,
        "page": COHORT_PAGE,
        "subjects": {
            subject: [trial.name for trial in trials if trial.subject == subject] for subject in study.subjects
        },
        "trials": [
            {
                "trial": trial.name,
                "subject": trial.subject,
                **own,
                "exit_code": trial.run.exit_code,
                "verdict": trial.level,
                "codes": trial.codes,
                "message": trial.run.published,
                "report": None if trial.summary is None else f"../{trial.name}/report.html",
            }
            for trial, own in zip(trials, labels, strict=True)
        ],
        "remarks": list(remarks),
        "segments": counts,
        "tables": {name: table.description for name, table in tables.items()},
        "key": key,
    }
    return Result("study", DOCUMENT, content, tables, make_page, hashed=True)


def _hash_content(study: Study, runs: Sequence[TrialRun]) -> str:
    """Return a hash of all inputs of tables and page: the trials' reports, the people, and the entries of the file."""
    trials = [
        [one.name, one.subject, one.strategy, one.session, one.condition, run.exit_code, run.published, run.key]
        for one, run in zip(study.trials, runs, strict=True)
    ]
    people = {name: person.model_dump(mode="json") for name, person in study.subjects.items()}
    return hash_bytes(dumps([_VERSION, __version__, study.name, study.reference, trials, people]).encode())


def _read_document(folder: Path) -> Mapping[str, Any]:
    """Return the content of study.json; empty if it is missing or unreadable."""
    try:
        return dict(json.loads((folder / DOCUMENT).read_text("utf-8")))
    except (OSError, ValueError, TypeError):
        return {}


def _is_unchanged(folder: Path, document: Mapping[str, Any]) -> bool:
    """Return whether all files that study.json lists are unchanged."""
    try:
        return all(hash_file(folder / file) == content for file, content in document["files"].items())
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return False  # missing or unreadable: write it again
