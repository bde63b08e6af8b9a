"""The tables of a reach study: columns, units and meanings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from mocap_id.reporting.results.columns import ResultTable, count, number, text, whole
from mocap_id.store import TableSchema
from mocap_id.workflows.reach_study.table_rows import correlation_rows, difference_rows, person_rows
from mocap_id.workflows.reach_study.trial_results import MEASURES, ReachResult
from mocap_id.workflows.study.study_outcome import TRIAL_COLUMNS, VERDICT_COLUMNS, estimate_columns, fill_tables

_SCORE = "clinical score of the person; NaN if not given"
_MEASURE = text("measure", "measure of reach: " + ", ".join(MEASURES))
_LEVELS = ("waist", "mouth", "overhead")


def _read_level(level: str) -> Callable[[ReachResult], int | None]:
    """Return a function of a trial that returns 1 if the level was reached, 0 if not, and None if this is unknown."""

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
            whole("trials", "number of trials with a known volume"),
            whole("of_trials", "number of all trials"),
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
            whole("people", "number of people whose score and measure are known"),
            *estimate_columns("spearman", "1", "Spearman's correlation with the score"),
            number("p", "1", "two-sided permutation p-value of the hypothesis of no correlation"),
        ),
    ),
    "differences": TableSchema(
        "differences.parquet",
        1,
        (
            text("comparison", "both sides or sessions: second minus first"),
            _MEASURE,
            text("subject", "id of the person; `cohort` = mean over all people"),
            text("label", "session in which sides are compared, or side in which sessions are compared"),
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
            *(
                count(level, f"1: reached the height of {level}; 0: not reached", _read_level(level))
                for level in _LEVELS
            ),
            text("why", "why the volume is unknown; empty otherwise", lambda trial: trial.why),
        ),
    ),
}
"""Schemas of the tables by name."""


def make_tables(trials: Sequence[ReachResult]) -> dict[str, ResultTable]:
    """Return the tables of a reach study by name."""
    rows = {"people": person_rows, "correlation": correlation_rows, "differences": difference_rows}
    return fill_tables(TABLES, rows, trials)
