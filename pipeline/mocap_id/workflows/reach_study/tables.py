"""The tables of a reach study: columns, units and meanings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from mocap_id.reporting.results.columns import ResultColumn as Column
from mocap_id.reporting.results.columns import ResultTable, count, number, text, whole
from mocap_id.store import TableSchema
from mocap_id.workflows.reach_study.differences_table import difference_rows
from mocap_id.workflows.reach_study.people_table import correlation_rows, person_rows
from mocap_id.workflows.reach_study.trial_results import MEASURES, ReachResult
from mocap_id.workflows.study.estimates import Estimate
from mocap_id.workflows.study.study_outcome import INTERVAL_ENDS, TRIAL_COLUMNS, VERDICT_COLUMNS, estimate_columns

_SCORE = "clinical score of the person; NaN if none"
_MEASURE = text("measure", "measure of reach: " + ", ".join(MEASURES))
_LEVELS = ("waist", "mouth", "overhead")


def _estimates(*, with_values: bool = False) -> Iterator[Column]:
    """Yield the columns of every measure, which take their values from a trial or have none."""
    for name, measure in MEASURES.items():
        for end, words in INTERVAL_ENDS.items():
            part = end[1:] or "value"
            value = _of(measure.of, part) if with_values else None
            yield number(f"{name}{end}", measure.unit, f"{measure.meaning}{words}", value)


def _of(estimate: Callable[[ReachResult], Estimate], part: str) -> Callable[[ReachResult], float]:
    return lambda trial: getattr(estimate(trial), part)


def _reached(level: str) -> Callable[[ReachResult], int | None]:
    def value(trial: ReachResult) -> int | None:
        found = trial.value("workspace", "heights", "levels", level)
        return None if found is None else int(found)

    return value


TRIALS = TableSchema(
    "trials.parquet",
    1,
    (
        *TRIAL_COLUMNS,
        text("side", "side of the arm", lambda trial: trial.side),
        text("session", "session of the recording", lambda trial: trial.session),
        number("score", "1", _SCORE, lambda trial: trial.score),
        *VERDICT_COLUMNS,
        *_estimates(with_values=True),
        *(count(level, f"1: reached the height of {level}; 0: did not", _reached(level)) for level in _LEVELS),
        text("why", "why the volume is unknown; else empty", lambda trial: trial.why),
    ),
)
PEOPLE = TableSchema(
    "people.parquet",
    1,
    (
        text("subject", "id of the person"),
        number("score", "1", _SCORE),
        whole("trials", "number of trials with a volume"),
        whole("of_trials", "number of trials"),
        *_estimates(),
        number("volume_right", "m^3", "reachable volume of the right arm, mean over its trials"),
        number("volume_left", "m^3", "reachable volume of the left arm, mean over its trials"),
    ),
)
CORRELATION = TableSchema(
    "correlation.parquet",
    1,
    (
        _MEASURE,
        whole("people", "number of people with score and measure"),
        *estimate_columns("spearman", "1", "Spearman's correlation with the score"),
        number("p", "1", "two-sided permutation p-value against no correlation"),
    ),
)
DIFFERENCES = TableSchema(
    "differences.parquet",
    1,
    (
        text("comparison", "what is subtracted from what: sides, or sessions"),
        _MEASURE,
        text("subject", "id of the person; `cohort` = mean over all people"),
        text("label", "session of a difference of sides, or side of a difference of sessions"),
        whole("people", "number of people in the row"),
        *estimate_columns("difference", "", "difference, in the measure's unit"),
        number("sd", "", "cohort: standard deviation of the differences, in the measure's unit"),
    ),
)
TABLES: Mapping[str, TableSchema] = {
    "people": PEOPLE,
    "correlation": CORRELATION,
    "differences": DIFFERENCES,
    "trials": TRIALS,
}
_ROWS: Mapping[str, Callable[[Sequence[ReachResult]], Iterable[Any]]] = {
    "people": person_rows,
    "correlation": correlation_rows,
    "differences": difference_rows,
    "trials": lambda trials: trials,
}


def make_tables(trials: Sequence[ReachResult]) -> dict[str, ResultTable]:
    """Return every table of a reach study."""
    return {name: ResultTable.of(schema, _ROWS[name](trials)) for name, schema in TABLES.items()}
