"""The tables of a study of curls: columns, units and meanings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mocap_id.reporting.results.columns import ResultTable, count, number, text, whole
from mocap_id.store import TableSchema
from mocap_id.workflows.curl_study.table_rows import comparison_rows, condition_rows
from mocap_id.workflows.curl_study.trial_results import ANGLES, MEASURES, CurlResult, normalise
from mocap_id.workflows.study.study_outcome import TRIAL_COLUMNS, VERDICT_COLUMNS, estimate_columns, fill_tables

_MEASURE = text("measure", "what is measured: " + ", ".join(MEASURES))
_QUANTILES = {
    "lowest": "lowest value",
    "q1": "lower quartile",
    "median": "median",
    "q3": "upper quartile",
    "highest": "highest value",
}


def _curl(key: str) -> Callable[[CurlResult], Any]:
    return lambda trial: trial.curl.get(key)


def _end(key: str) -> Callable[[CurlResult], Any]:
    return lambda trial: (trial.curl.get("end") or {}).get(key)


def _floor(angle: str) -> Callable[[CurlResult], float]:
    return lambda trial: trial.average_compensation(angle, "floor_rad")


TABLES: Mapping[str, TableSchema] = {
    "conditions": TableSchema(
        "conditions.parquet",
        1,
        (
            text("condition", "condition of the trials"),
            _MEASURE,
            whole("people", "number of people"),
            whole("trials", "number of trials in which the measure is known"),
            whole("of_trials", "number of all trials"),
            *estimate_columns("mean", "", "mean over people, in the measure's unit"),
            *(number(name, "", f"{words} of the trials, in the measure's unit") for name, words in _QUANTILES.items()),
        ),
    ),
    "comparisons": TableSchema(
        "comparisons.parquet",
        1,
        (
            text("comparison", "both conditions: `second - first`"),
            text("first", "condition that is subtracted"),
            text("second", "condition from which the first is subtracted"),
            _MEASURE,
            text("subject", "id of the person; `cohort` = mean over all people"),
            whole("people", "number of people"),
            whole("pairs", "number of pairs of trials with the same person and the same number"),
            *estimate_columns("difference", "", "difference, in the measure's unit"),
            number("p", "1", "cohort: two-sided permutation p-value, not corrected for several tests"),
            number("sd_between", "", "cohort: standard deviation of the people's mean differences"),
            number("sd_within", "", "standard deviation of one person's differences; cohort: pooled over all people"),
        ),
    ),
    "trials": TableSchema(
        "trials.parquet",
        1,
        (
            *TRIAL_COLUMNS,
            text("condition", "condition of the trial", lambda trial: trial.condition),
            whole("number", "number of the trial of the person in this condition, from 1", lambda trial: trial.number),
            *VERDICT_COLUMNS,
            count("partial", "number of failed attempts", _curl("partial")),
            count("after_end", "number of complete curls after the end, not counted", _curl("after_end")),
            number("end", "s", "end of the trial", _end("time_s")),
            text("end_rule", "rule that determines the end", _end("rule")),
            *(number(name, measure.unit, measure.meaning, measure.of) for name, measure in MEASURES.items()),
            *(
                number(
                    f"floor_{angle}",
                    "deg",
                    f"range of {angle.replace('_', ' ')} that errors alone can cause, mean over the curls",
                    _floor(angle),
                )
                for angle in ANGLES
            ),
            text("why", "why the repetitions are unknown or zero; empty otherwise", lambda trial: trial.why),
        ),
    ),
}
"""Schemas of the tables by name."""


def make_tables(trials: Sequence[CurlResult]) -> dict[str, ResultTable]:
    """Return the tables of a study of curls by name."""
    rows = {"conditions": condition_rows, "comparisons": comparison_rows}
    return fill_tables(TABLES, rows, normalise(trials))
