"""``mocap-id study``: run every trial, then write the tables and the page of the cohort unless they are up to date.

In the plane, all trials of a person have one number of segments. Alone, every trial chooses the number that explains
its own markers best. Two trials of a person may then differ, and so do the meanings of their joints. The number used
for both is the one with the smallest sum of the costs.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib import import_module
from itertools import permutations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from scipy.special import stdtrit

from mocap_id import __version__
from mocap_id.arrays import FloatArray
from mocap_id.config import Trial
from mocap_id.config.study import Study, StudyTrial, load_study
from mocap_id.dynamics.prediction import Agreement
from mocap_id.errors import StoreError
from mocap_id.reporting import COHORT, COHORT_PAGE, SUMMARY_FILE
from mocap_id.reporting.results import CommandResult, ResultTable
from mocap_id.stages import STAGES
from mocap_id.stages.trial_keys import list_sensors
from mocap_id.store import Folder, TableSchema, dumps, hash_bytes, hash_file
from mocap_id.store.folder import Owner, check_owner, hash_texts, store_owner
from mocap_id.workflows.parallel import LocalBackend, TrialCallback, TrialRun, run_trials
from mocap_id.workflows.trial_outcome import TrialOutcome

if TYPE_CHECKING:
    from mocap_id.reporting.study import CohortData

T = TypeVar("T")
K = TypeVar("K", bound=Hashable)
_FEWEST = 4  # smallest number of people for which a correlation is computed
_MOST_SIGNS, _MOST_ORDERS = 14, 7  # largest numbers of people for which all signs, and all orders, are compared
_DRAWS = 20_000  # number of random signs or orders for more people
_SAMPLES, _STEPS = 2000, 81  # samples of a population with one correlation, and number of these correlations
_SEED = 20


@dataclass(frozen=True)
class IntervalEstimate:
    """A value with the ends of its 95 % interval; NaN if unknown."""

    value: float = math.nan
    low: float = math.nan
    high: float = math.nan

    def minus(self, other: IntervalEstimate) -> IntervalEstimate:
        """Return this estimate minus ``other``, with an interval that assumes independent errors."""
        value = self.value - other.value
        below = math.hypot(self.value - self.low, other.high - other.value)
        above = math.hypot(self.high - self.value, other.value - other.low)
        return IntervalEstimate(value, value - below, value + above)

    def columns(self, name: str) -> dict[str, float]:
        return {name: self.value, f"{name}_low": self.low, f"{name}_high": self.high}


def group_by(members: Iterable[T], key: Callable[[T], K]) -> Mapping[K, list[T]]:
    """Return lists of members by key, in the order in which the keys first occur."""
    groups: dict[K, list[T]] = {}
    for member in members:
        groups.setdefault(key(member), []).append(member)
    return groups


def find_mean_sd(values: Iterable[float | None]) -> tuple[float, float]:
    """Return mean and sample standard deviation (n − 1) of the known values; NaN if there are too few values.

    >>> find_mean_sd([1.0, None, 3.0])
    (2.0, 1.4142135623730951)
    """
    known = np.array([value for value in values if value is not None and math.isfinite(value)])
    return float(known.mean()) if len(known) else math.nan, sd_of(known)


def named_mean_sd(name: str, values: Iterable[float | None]) -> dict[str, float]:
    """Return mean and standard deviation as the columns ``name_mean`` and ``name_sd``."""
    return dict(zip((f"{name}_mean", f"{name}_sd"), find_mean_sd(values), strict=True))


def sd_of(values: Sequence[float] | FloatArray) -> float:
    """Return the sample standard deviation (n − 1); NaN for less than two values."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else math.nan


def pool_people(
    rows: Iterable[Mapping[str, Any]], keys: Sequence[str], columns: Mapping[str, tuple[str, str]]
) -> Iterator[dict[str, Any]]:
    """Yield a row of the cohort for each combination of ``keys``, from one row for each person.

    ``columns`` names the pooled columns of the people, and for each the columns of the mean and of the standard
    deviation over the people; an empty name leaves one out.
    """
    for group, own in group_by(rows, lambda row: tuple(row[key] for key in keys)).items():
        row = dict(zip(keys, group, strict=True)) | {"subject": COHORT, "subjects": len(own)}
        row["trials"] = sum(one["trials"] for one in own)
        for column, names in columns.items():
            row |= {
                name: value for name, value in zip(names, find_mean_sd(one[column] for one in own), strict=True) if name
            }
        yield row


def pool_differences(people: Mapping[str, Sequence[float]], columns: str) -> dict[str, Any]:
    """Return the cohort's row of paired differences, from the differences of each person.

    The row has the number of people, the mean over the people with its interval, and these ``columns``, separated by
    blanks: ``pairs``, ``p`` (see :func:`sign_flip_p`), and the standard deviations ``sd`` of all differences,
    ``sd_between`` of the people's means and ``sd_within`` people, pooled.
    """
    means = [float(np.mean(own)) for own in people.values()]
    freedom = sum(len(own) - 1 for own in people.values())
    squares = sum(float(np.var(own)) * len(own) for own in people.values())
    find: Mapping[str, Callable[[], float]] = {
        "pairs": lambda: sum(map(len, people.values())),
        "p": lambda: sign_flip_p(means),
        "sd": lambda: sd_of([one for own in people.values() for one in own]),
        "sd_between": lambda: sd_of(means),
        "sd_within": lambda: float(np.sqrt(squares / freedom)) if freedom else math.nan,
    }
    row = {"people": len(means), **average_people(means).columns("difference")}
    return row | {name: find[name]() for name in columns.split()}


def pool_errors(errors: Sequence[Agreement | None]) -> tuple[float, float]:
    """Return mean and standard deviation of the samples of several errors together; each error has the same weight.

    From means b_i and standard deviations s_i: the mean b of the b_i, and sqrt(mean(s_i² + b_i²) − b²). NaN without a
    known error.
    """
    known = [error for error in errors if error is not None]
    if not known:
        return math.nan, math.nan
    bias = np.array([error.bias for error in known])
    square = np.array([error.sd**2 + error.bias**2 for error in known])
    mean = float(bias.mean())
    return mean, math.sqrt(max(float(square.mean()) - mean**2, 0.0))


def average_estimates(estimates: Iterable[IntervalEstimate]) -> IntervalEstimate:
    """Return the mean of the known estimates; its interval assumes that all estimates have the same error.

    >>> average_estimates([IntervalEstimate(0.2, 0.1, 0.3), IntervalEstimate(0.4, 0.3, 0.5), IntervalEstimate()])
    IntervalEstimate(value=0.30000000000000004, low=0.2, high=0.4)
    """
    rows = np.array([(one.value, one.low, one.high) for one in estimates if math.isfinite(one.value)])
    return IntervalEstimate(*rows.mean(axis=0).tolist()) if len(rows) else IntervalEstimate()


def average_people(values: Sequence[float]) -> IntervalEstimate:
    """Return the mean of the people's values with Student's interval, which is NaN for one person.

    >>> average_people([1.0, 2.0, 3.0]).value
    2.0
    """
    array = np.asarray(values, dtype=np.float64)
    n = len(array)
    if not n:
        return IntervalEstimate()
    half = float(stdtrit(n - 1, 0.975) * array.std(ddof=1) / np.sqrt(n)) if n > 1 else math.nan
    mean = float(array.mean())
    return IntervalEstimate(mean, mean - half, mean + half)


def sign_flip_p(differences: Sequence[float]) -> float:
    """Return the two-sided permutation p-value of the hypothesis that the differences have no preferred sign.

    All combinations of signs are compared, or 20,000 random combinations for more than 14 people. NaN for one person.

    >>> sign_flip_p([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])  # 2 of 64
    0.03125
    """
    array = np.asarray(differences, dtype=np.float64)
    n = len(array)
    if n < 2:
        return math.nan
    least = abs(array.sum()) - 1e-12 * np.abs(array).sum()
    if n <= _MOST_SIGNS:
        signs = np.array(list(product((-1.0, 1.0), repeat=n)))
        return float(np.mean(np.abs(signs @ array) >= least))
    signs = np.random.default_rng(_SEED).choice([-1.0, 1.0], (_DRAWS, n))
    return float((1 + (np.abs(signs @ array) >= least).sum()) / (1 + _DRAWS))


def correlate_ranks(x: FloatArray, y: FloatArray) -> tuple[IntervalEstimate, float, int]:
    """Return Spearman's correlation of ``x`` (N,), which may have ties, with ``y`` (N,); pairs with a NaN are left out.

    Correlation and p-value are NaN for fewer than four people, or if a variable is constant. The last result is the
    number of people for whom both variables are known.

    The two-sided p-value of no correlation compares all orders of ``y``, or 20,000 random orders for more than seven
    people. The interval contains the correlations of a normal copula for which the observed value is not in the upper
    or lower 2.5 % of samples with the ties of ``x``. A bootstrap fails, because each resample of perfectly ordered
    people is ordered too.

    >>> estimate, p, _ = correlate_ranks(np.array([1.0, 2.0, 3.0, 5.0]), np.array([0.358, 0.270, 0.178, 0.0015]))
    >>> estimate.value, round(p, 3)
    (-1.0, 0.083)
    """
    known = np.isfinite(x) & np.isfinite(y)
    first, second = _rank(x[known]), _rank(y[known])
    n = int(known.sum())
    if n < _FEWEST or np.ptp(first) == 0 or np.ptp(second) == 0:
        return IntervalEstimate(), math.nan, n
    value = float(_correlate(first, second[None])[0])
    if n <= _MOST_ORDERS:
        orders = np.array(list(permutations(second)))
        p = float((np.abs(_correlate(first, orders)) >= abs(value)).sum() / math.factorial(n))
    else:
        orders = np.random.default_rng(_SEED).permuted(np.tile(second, (_DRAWS, 1)), axis=1)
        p = float((1 + (np.abs(_correlate(first, orders)) >= abs(value)).sum()) / (1 + len(orders)))
    # The lowest and highest correlation in the population for which the value is plausible at these ranks.
    rng = np.random.default_rng(_SEED)
    hidden = np.sort(rng.standard_normal((_SAMPLES, n)), axis=1)[:, np.argsort(np.argsort(first, kind="stable"))]
    noise = rng.standard_normal((_SAMPLES, n))
    levels = np.linspace(-1, 1, _STEPS)  # Spearman's correlation in the population
    above, below = [], []
    for pearson in 2 * np.sin(np.pi / 6 * levels):
        sample = pearson * hidden + np.sqrt(max(1 - pearson**2, 0.0)) * noise
        drawn = _correlate(first, sample.argsort(axis=1).argsort(axis=1).astype(np.float64))
        above.append(np.mean(drawn >= value))
        below.append(np.mean(drawn <= value))
    possible = levels[(np.array(above) > 0.025) & (np.array(below) > 0.025)]
    return IntervalEstimate(value, float(possible.min()), float(possible.max())), p, n


def _rank(values: FloatArray) -> FloatArray:
    """Return the ranks (N,) from 1; tied values share the mean of their ranks.

    >>> _rank(np.array([3.0, 1.0, 3.0]))
    array([2.5, 1. , 2.5])
    """
    below = (values[None] < values[:, None]).sum(axis=1)
    same = (values[None] == values[:, None]).sum(axis=1)
    return np.asarray(below + (same + 1) / 2)


def _correlate(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the correlations (K,) of x (N,) with each row of y (K, N)."""
    x, y = x - x.mean(), y - y.mean(axis=1, keepdims=True)
    return np.asarray(np.clip(y @ x / np.sqrt((x @ x) * (y**2).sum(axis=1)), -1, 1).round(12))


DOCUMENT = "study.json"
_SAME_MASS, _SAME_LENGTH = 0.10, 0.12  # largest relative differences between two trials of one person
_SURE = 4.0  # standard deviations by which two lengths of different people differ
_VERSION = 5  # raised whenever the same trials would give other tables or another page
_ABOUT = (
    "Each table is a CSV and a Parquet file (units and meanings in the field metadata). A row with the subject "
    "`cohort` is about all people. A missing value is empty in CSV and NaN in Parquet."
)
_SEGMENT = "segment"


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
        return {name: getattr(trial, name) for name in self.labels}

    def make_tables(self, trials: Sequence[Any]) -> dict[str, ResultTable]:
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
        return self.study.folder / COHORT_PAGE


def run_study(
    file: Path,
    jobs: int = 1,
    begin: Callable[[int], None] = lambda trials: None,
    tell: TrialCallback = lambda run: None,
) -> StudyResult:
    """Run all trials of a study, ``jobs`` at the same time, write its tables and page, and return the result.

    ``begin`` is called with the number of trials before the first trial runs, and ``tell`` with each finished trial.

    Raises
    ------
    ConfigError
        The file is wrong; no trial was run.
    StoreError
        The study's folder is in use, cannot be written, or belongs to another study. The failure of a trial raises
        nothing; it is in the tables.
    """
    study = load_study(file)
    # The owner of the tables: the study's name with one of its recordings is enough to know it again.
    contents = []
    for one in study.trials:
        keys = one.trial.keys
        files = [keys.recording.motion] if keys.recording else [one.file for one in list_sensors(keys.imus).values()]
        place = [os.path.relpath(file, study.file.parent) for file in files]
        contents.append(hash_texts([study.name, one.name, *place]))
    owner = Owner(study.name, study.file, tuple(contents))
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

        try:
            before = dict(json.loads((study.folder / DOCUMENT).read_text("utf-8")))
        except (OSError, ValueError, TypeError):
            before = {}  # missing or unreadable
        counts, remarks = dict[str, Any](), list[str]()
        if study.curl or study.reach:  # the segments of an arm have names
            runs = run([one.trial for one in study.trials])
        else:
            known = before.get("segments")
            runs, counts, remarks = run_with_counts(study.trials, known if isinstance(known, dict) else {}, run)
        # A hash of all inputs of tables and page: the trials' reports, the people, and the entries of the file.
        entries = [
            [one.name, one.subject, one.strategy, one.session, one.condition, done.exit_code, done.published, done.key]
            for one, done in zip(study.trials, runs, strict=True)
        ]
        people = {name: person.model_dump(mode="json") for name, person in study.subjects.items()}
        key = hash_bytes(dumps([_VERSION, __version__, study.name, study.reference, entries, people]).encode())
        try:
            is_current = before.get("key") == key and all(
                hash_file(study.folder / file) == content for file, content in before["files"].items()
            )
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            is_current = False  # a file is missing or unreadable: write it again
        store_owner(study.folder, owner, DOCUMENT)
        if is_current:
            return StudyResult(study, runs, before, reused=True)
        # The modules of the other kinds are not imported.
        module = import_module(f"mocap_id.workflows.study.{'arms' if study.curl or study.reach else 'sit_to_stand'}")
        kind: StudyKind = module.CURLS if study.curl else module.REACHES if study.reach else module.STUDY
        trials = [kind.read(study, one, run) for one, run in zip(study.trials, runs, strict=True)]
        labels = [kind.read_labels(trial) for trial in trials]
        remarks += find_remarks(study, trials)
        tables = kind.make_tables(trials)

        def make_page() -> dict[str, bytes]:
            from mocap_id.reporting.study import CohortData  # noqa: PLC0415  only a page needs it

            entries = tuple(
                one.entry(one.name, ", ".join(filter(None, [one.subject, *own.values()])), f"../{one.name}/report.html")
                for one, own in zip(trials, labels, strict=True)
            )
            return {COHORT_PAGE: kind.page(CohortData(study.name, entries, tables, tuple(remarks)), trials)}

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
            "remarks": remarks,
            "segments": counts,
            "tables": {name: table.description for name, table in tables.items()},
            "key": key,
        }
        result = CommandResult("study", DOCUMENT, content, tables, make_page, hashed=True)
        result.write(study.folder)
    return StudyResult(study, runs, result.document, reused=False)


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
    none = (0.0, 0.0, "")
    for subject in study.subjects:
        own = [(one.name, trial) for one, trial in zip(study.trials, trials, strict=True) if one.subject == subject]
        masses = [(float(mass), 0.0, name) for name, trial in own if (mass := trial.value("dynamics", "mass_kg"))]
        found = [("the mass", "kg", masses, _SAME_MASS)]
        for segment in dict.fromkeys(segment for _, trial in own for segment in trial.value("lengths_m") or ()):
            lengths = [(trial.value("lengths_m", segment), name) for name, trial in own]
            known = [(float(each["value"]), float(each["sd"] or 0.0), name) for each, name in lengths if each]
            found.append((f"the length of the {segment.replace('_', ' ')}", "m", known, _SAME_LENGTH))
        for what, unit, values, limit in found:
            (low, low_sd, first), (high, high_sd, second) = min(values, default=none), max(values, default=none)
            if high - low > max(limit * (high + low) / 2, _SURE * math.hypot(low_sd, high_sd)):
                yield (
                    f"{subject} may be two people: {what} is {low:.3g} {unit} in {first} and {high:.3g} {unit} in "
                    f"{second}. Check the ids of these trials; the numbers of {subject} are means over both"
                )
                break


# One number of segments for all trials of a person.


@dataclass(frozen=True)
class Evidence:
    """What a trial alone says about the number of its segments."""

    alone: int  # the number that it chose
    base: str  # name of its base; a trial in which the foot turns on the floor has another chain
    costs: Mapping[int, float]  # cost of the best segments, by their number; smaller is better
    inputs: str  # hash of everything from which this follows

    @classmethod
    def read(cls, trial: Trial) -> Evidence | None:
        """Return the evidence of a finished trial; None if it has no segments."""
        settings: Any = trial.settings[_SEGMENT]
        try:
            segments = json.loads((trial.out / SUMMARY_FILE).read_text("utf-8"))["segments"]
            inputs = _hash_inputs(trial)
        except (OSError, ValueError, StoreError):
            return None
        if segments["count"] is None or not segments["names"]:
            return None
        count = int(segments["count"])
        costs: dict[int, float] = {}
        for each in segments["hypotheses"] or ():
            costs[each["segments"]] = min(each["cost"], costs.get(each["segments"], each["cost"]))
        if count not in costs or settings.count is not None or settings.names is not None:
            costs = {count: 0.0}  # the user or a turning foot fixes the number, or no other number was compared
        return cls(count, segments["names"][0], costs, inputs)


def _hash_inputs(trial: Trial) -> str:
    """Return a hash of everything from which the segments of a finished trial follow, except their number."""
    stage = next(stage for stage in STAGES if stage.name == _SEGMENT)
    settings = trial.settings[_SEGMENT].model_dump(mode="json", exclude={"count", "count_alone"})
    origin = Folder(trial.out).origin(STAGES[0].name, STAGES[0].outputs)
    return hash_bytes(dumps([stage.version, settings, None if origin is None else origin.key]).encode())


def _fix_count(trial: Trial, count: int, alone: int) -> Trial:
    """Return a trial with a number of segments that was chosen together; ``alone`` is the number it has alone."""
    settings = trial.settings[_SEGMENT].model_copy(update={"count": count, "count_alone": alone})
    return replace(trial, settings={**trial.settings, _SEGMENT: settings})


def run_with_counts(
    trials: Sequence[StudyTrial],
    known: Mapping[str, Mapping[str, Any]],
    run: Callable[[list[Trial]], Sequence[TrialRun]],
) -> tuple[tuple[TrialRun, ...], dict[str, Any], list[str]]:
    """Run the trials by ``run``, and those whose number of segments differs from the person's other trials once more.

    ``known`` is the second result of the previous time, from study.json, so that a trial with another number is not run
    twice each time. Return the runs; for study.json, the number and the evidence of each trial that has not the number
    that it chose; and remarks.
    """
    alone = {one.name: one.trial for one in trials}
    now = dict(alone)
    for name, entry in known.items():
        settings: Any = alone[name].settings[_SEGMENT] if name in alone else None
        if settings is not None and settings.count is None and settings.names is None:
            now[name] = _fix_count(alone[name], int(entry["count"]), int(entry["alone"]))
    runs = dict(zip(now, run(list(now.values())), strict=True))

    def run_again(names: Mapping[str, Trial]) -> None:
        now.update(names)
        runs.update(zip(names, run(list(names.values())) if names else (), strict=True))

    fixed = {name for name in now if now[name] is not alone[name]}
    stale = {n for n in fixed if runs[n].exit_code or _hash_inputs(alone[n]) != known[n]["inputs"]}
    run_again({name: alone[name] for name in sorted(stale)})
    found: dict[str, Evidence] = {}
    for name, trial in alone.items():
        one = None
        if name in fixed - stale:
            entry = known[name]
            costs = {int(number): float(cost) for number, cost in entry["costs"].items()}
            one = Evidence(int(entry["alone"]), str(entry["base"]), costs, str(entry["inputs"]))
        elif runs[name].exit_code == 0:
            one = Evidence.read(trial)
        if one is not None:
            found[name] = one
    chosen = choose_counts(trials, found)
    wanted = {name: _fix_count(alone[name], chosen[name], found[name].alone) for name in chosen}
    wanted |= {name: alone[name] for name in fixed - stale - chosen.keys()}
    run_again({name: trial for name, trial in wanted.items() if trial.settings != now[name].settings})
    failed = {name: alone[name] for name in chosen if runs[name].exit_code}
    run_again(failed)  # as it was: a trial with its own number is better than none
    chosen = {name: count for name, count in chosen.items() if name not in failed}
    changed = {name: {"count": count, **asdict(found[name])} for name, count in chosen.items()}
    return tuple(runs.values()), changed, describe_counts(trials, found, chosen)


def choose_counts(trials: Sequence[StudyTrial], found: Mapping[str, Evidence]) -> dict[str, int]:
    """Return the number of segments, by trial, of the trials that should have another number than alone.

    The number is that of the smallest sum of costs among the numbers that every trial of the person considered. The
    number stays as it is if there is none.
    """
    groups: dict[tuple[str, str], list[str]] = {}
    for one in trials:
        if one.name in found:
            groups.setdefault((one.subject, found[one.name].base), []).append(one.name)
    chosen: dict[str, int] = {}
    for names in groups.values():
        own = [found[name] for name in names]
        common = set.intersection(*(set(each.costs) for each in own))
        if len({each.alone for each in own}) == 1 or not common:
            continue
        count = min(sorted(common), key=lambda number: sum(each.costs[number] for each in own))
        chosen |= {name: count for name, each in zip(names, own, strict=True) if each.alone != count}
    return chosen


def describe_counts(
    trials: Sequence[StudyTrial], found: Mapping[str, Evidence], chosen: Mapping[str, int]
) -> list[str]:
    """Return a remark about each person whose trials have, alone, different numbers of segments."""
    remarks = []
    for subject in dict.fromkeys(one.subject for one in trials):
        own = [one.name for one in trials if one.subject == subject and one.name in found]
        changed = [name for name in own if name in chosen]
        if changed:
            listed = ", ".join(f"{name} (alone {found[name].alone})" for name in changed)
            remarks.append(
                f"the number of segments of {subject}, {chosen[changed[0]]}, was chosen from all trials together; it "
                f"changes {listed}"
            )
        numbers = {name: chosen.get(name, found[name].alone) for name in own}
        if len(set(numbers.values())) > 1:
            listed = ", ".join(f"{name} {number}" for name, number in numbers.items())
            remarks.append(
                f"the trials of {subject} have different numbers of segments ({listed}), so their joints do not mean "
                "the same; give `segment: {count: …}` for all of them"
            )
    return remarks
