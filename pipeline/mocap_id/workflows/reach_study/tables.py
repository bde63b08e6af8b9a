"""The tables of a reach study: columns, units and meanings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from mocap_id.reporting.results.columns import ResultTable, count, number, text, whole
from mocap_id.store import TableSchema
from mocap_id.workflows.reach_study.table_rows import correlation_rows, difference_rows, person_rows
from mocap_id.workflows.reach_study.trial_results import MEASURES, ReachResult
from mocap_id.workflows.study.study_outcome import TRIAL_COLUMNS, VERDICT_COLUMNS, estimate_columns, fill_tables

_SCORE = "clinical score of the person; NaN if none"
_MEASURE = text("measure", "measure of reach: " + ", ".join(MEASURES))
_LEVELS = ("waist", "mouth", "overhead")


def _read_level(level: str) -> Callable[[ReachResult], int | None]:
    """Return a function that returns 1 if a trial reached a level, 0 if it did not, and None if unknown."""

    def read(trial: ReachResult) -> int | None:
        reached = trial.value("workspace", "heights", "levels", level)
        return None if reached is None else int(reached)

    return read


TABLES: Mapping[str, TableSchema] = {
    "people": TableSchema(
        "people.parquet",
        1,
        (
            text("subject", "id of the person"),
            number("score", "1", _SCORE),
            whole("trials", "number of trials with a volume"),
            whole("of_trials", "number of trials"),
            *(column for name, one in MEASURES.items() for column in estimate_columns(name, one.unit, one.meaning)),
            number("volume_right", "m^3", "reachable volume of the right arm, mean over its trials"),
            number("volume_left", "m^3", "reachable volume of the left arm, mean over its trials"),
        ),
    ),
    "correlation": TableSchema(
        "correlation.parquet",
        1,
        (
            _MEASURE,
            whole("people", "number of people with score and measure"),
            *estimate_columns("spearman", "1", "Spearman's correlation with the score"),
            number("p", "1", "two-sided permutation p-value against no correlation"),
        ),
    ),
    "differences": TableSchema(
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
    ),
    "trials": TableSchema(
        "trials.parquet",
        1,
        (
            *TRIAL_COLUMNS,
            text("side", "side of the arm", lambda trial: trial.side),
            text("session", "session of the recording", lambda trial: trial.session),
            number("score", "1", _SCORE, lambda trial: trial.score),
            *VERDICT_COLUMNS,
            *(
                column
                for name, one in MEASURES.items()
                for column in estimate_columns(name, one.unit, one.meaning, one.of)
            ),
            *(count(level, f"1: reached the height of {level}; 0: did not", _read_level(level)) for level in _LEVELS),
            text("why", "why the volume is unknown; else empty", lambda trial: trial.why),
        ),
    ),
}
"""Schemas of the tables by name."""


def make_tables(trials: Sequence[ReachResult]) -> dict[str, ResultTable]:
    """Return the tables of a reach study by name."""
    rows = {"people": person_rows, "correlation": correlation_rows, "differences": difference_rows}
    return fill_tables(TABLES, rows, trials)
