"""The tables of a study of curls: columns, units and meanings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from mocap_id.reporting.results.columns import ResultTable, count, number, text, whole
from mocap_id.store import TableSchema
from mocap_id.workflows.curl_study.comparisons_table import comparison_rows
from mocap_id.workflows.curl_study.conditions_table import condition_rows
from mocap_id.workflows.curl_study.trial_results import ANGLES, MEASURES, CurlResult, normalise
from mocap_id.workflows.study.study_outcome import TRIAL_COLUMNS, VERDICT_COLUMNS, estimate_columns

_MEASURE = text("measure", "what is measured: " + ", ".join(MEASURES))

TRIALS = TableSchema(
    "trials.parquet",
    1,
    (
        *TRIAL_COLUMNS,
        text("condition", "condition of the trial", lambda trial: trial.condition),
        whole("number", "number of the trial of the person in this condition, from 1", lambda trial: trial.number),
        *VERDICT_COLUMNS,
        count("partial", "failed attempts", lambda trial: trial.curl.get("partial")),
        count("after_end", "complete curls after the end, not counted", lambda trial: trial.curl.get("after_end")),
        number("end", "s", "end of the trial", lambda trial: (trial.curl.get("end") or {}).get("time_s")),
        text("end_rule", "rule that ends it", lambda trial: (trial.curl.get("end") or {}).get("rule")),
        *(number(name, measure.unit, measure.meaning, measure.of) for name, measure in MEASURES.items()),
        *(
            number(
                f"floor_{angle}",
                "deg",
                f"range of {angle.replace('_', ' ')} that errors alone can show, mean over the curls",
                lambda trial, angle=angle: trial.compensation(angle, "floor_rad"),  # type: ignore[misc]
            )
            for angle in ANGLES
        ),
        text("why", "why the repetitions are unknown, or there are none; else empty", lambda trial: trial.why),
    ),
)
CONDITIONS = TableSchema(
    "conditions.parquet",
    1,
    (
        text("condition", "condition of the trials"),
        _MEASURE,
        whole("people", "number of people"),
        whole("trials", "number of trials with the measure"),
        whole("of_trials", "number of trials"),
        *estimate_columns("mean", "", "mean over people, in the measure's unit"),
        *(
            number(name, "", f"{meaning} of the trials, in the measure's unit")
            for name, meaning in (
                ("lowest", "lowest"),
                ("q1", "lower quartile"),
                ("median", "median"),
                ("q3", "upper quartile"),
                ("highest", "highest"),
            )
        ),
    ),
)
COMPARISONS = TableSchema(
    "comparisons.parquet",
    1,
    (
        text("comparison", "what is subtracted from what"),
        text("first", "condition that is subtracted"),
        text("second", "condition that it is subtracted from"),
        _MEASURE,
        text("subject", "id of the person; `cohort` = mean over all people"),
        whole("people", "number of people"),
        whole("pairs", "number of pairs of trials of the same person and number"),
        *estimate_columns("difference", "", "difference, in the measure's unit"),
        number("p", "1", "cohort: two-sided permutation p-value, not corrected for several tests"),
        number("sd_between", "", "cohort: standard deviation between people of their mean differences"),
        number("sd_within", "", "standard deviation of the differences of one person"),
    ),
)
TABLES: Mapping[str, TableSchema] = {"conditions": CONDITIONS, "comparisons": COMPARISONS, "trials": TRIALS}
_ROWS: Mapping[str, Callable[[Sequence[CurlResult]], Iterable[Any]]] = {
    "conditions": condition_rows,
    "comparisons": comparison_rows,
    "trials": lambda trials: trials,
}


def make_tables(trials: Sequence[CurlResult]) -> dict[str, ResultTable]:
    """Return every table of a study of curls."""
    compared = normalise(trials)
    return {name: ResultTable.of(schema, _ROWS[name](compared)) for name, schema in TABLES.items()}
