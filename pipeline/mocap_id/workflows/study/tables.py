"""The tables of a study: columns, units and meanings. Rows with the subject `cohort` are about all people together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

from mocap_id.reporting.results.columns import ResultColumn as Column
from mocap_id.reporting.results.columns import ResultTable, count, number, text, whole
from mocap_id.store import TableSchema
from mocap_id.workflows.study.lengths_table import length_rows, strategy_rows
from mocap_id.workflows.study.models_table import model_rows
from mocap_id.workflows.study.study_outcome import TRIAL_COLUMNS, VERDICT_COLUMNS, fill_tables
from mocap_id.workflows.study.trial_results import SEGMENTS, TrialResult
from mocap_id.workflows.study.variation_table import parameter_rows, variation_rows
from mocap_id.workflows.transfer import SERIES
from mocap_id.workflows.trial_outcome import SUMMARY_COLUMNS, read_entry

_SUBJECT = text("subject", "id of the person; `cohort` = all people")
_STRATEGY = text("strategy", "strategy of the movement", lambda trial: trial.strategy)
_SUBJECTS = whole("subjects", "number of people in the row")
_TRIALS = whole("trials", "number of trials in the row")
_REFERENCE = text(
    "reference", "reference of the lengths: landmarks, or stature and allometric table", lambda t: t.reference.kind
)
_WHY = text("why", "why numbers are missing; empty otherwise")
_PARAMETER = (
    text("parameter", "short name as in the thesis: m1, mx1, mr2, I2 …"),
    text("expression", "the parameters that are regrouped into this parameter"),
    text("unit", "kg, kg*m or kg*m^2"),
)
_PARTS = {"mean": "mean", "sd": "standard deviation", "rms": "root mean square"}
_LENGTH_ERROR = "minus reference, relative to the reference"


def _errors(name: str, unit: str, meaning: str, parts: Sequence[str] = ("mean", "sd", "rms")) -> list[Column]:
    return [number(f"{name}_{part}", unit, f"{meaning}: {_PARTS[part]}") for part in parts]


def _mean_sd(name: str, unit: str, meaning: str) -> list[Column]:
    return _errors(name, unit, meaning, ("mean", "sd"))


def _count_repetitions(trial: TrialResult, *, complete: bool = False) -> int | None:
    repetitions = trial.value("repetitions")
    return None if repetitions is None else sum(bool(one["complete"]) or not complete for one in repetitions)


def _segment_columns(segment: str, ends: str) -> tuple[Column, ...]:
    return (
        number(segment, "m", f"length of the {segment}, {ends}", lambda trial: trial.length(segment)),
        number(f"{segment}_sd", "m", "its standard deviation", read_entry("lengths_m", segment, "sd")),
    )


def _length_reference(segment: str) -> Column:
    meaning = f"reference length of the {segment}"
    return number(f"{segment}_reference", "m", meaning, lambda trial: trial.reference.lengths[segment])


def _length_error(segment: str) -> Column:
    meaning = f"{segment} {_LENGTH_ERROR}"
    return number(f"{segment}_error", "%", meaning, lambda trial: trial.length_error(segment))


def _model_errors(model: str, meaning: str) -> Iterator[Column]:
    def read_part(name: str, part: int) -> Callable[[TrialResult], float | None]:
        return lambda trial: trial.model_errors(model).get(name, (None, None, None))[part]

    for name, unit in SERIES.items():
        for part, column in enumerate(_errors(f"{name}_{model}", unit, meaning)):
            yield number(column.name, unit, column.meaning, read_part(name, part))


_FIVE_TIMES = "time from the start of the first rise to the fifth"
TRIALS = TableSchema(
    "trials.parquet",
    1,
    (
        *TRIAL_COLUMNS,
        _STRATEGY,
        *VERDICT_COLUMNS,
        *(SUMMARY_COLUMNS[name] for name in ("segments", "confidence")),
        *_segment_columns("shank", "knee to ankle"),
        *_segment_columns("thigh", "hip to knee"),
        _REFERENCE,
        *map(_length_reference, SEGMENTS),
        *map(_length_error, SEGMENTS),
        *(SUMMARY_COLUMNS[name] for name in ("reprojection", "missing_fraction", "mass")),
        count("samples", "number of samples of the fit", read_entry("dynamics", "samples")),
        *(SUMMARY_COLUMNS[name] for name in ("condition_number", "clock_offset")),
        count("repetitions", "number of repetitions found", _count_repetitions),
        count(
            "complete", "number of repetitions with all their events", lambda t: _count_repetitions(t, complete=True)
        ),
        number("five_times", "s", f"{_FIVE_TIMES} stand", read_entry("five_times", "to_fifth_stand_s")),
        number("five_times_sd", "s", "its standard deviation", read_entry("five_times", "to_fifth_stand_sd_s")),
        number(
            "five_times_seated", "s", f"{_FIVE_TIMES} seat contact", read_entry("five_times", "to_fifth_seat_contact_s")
        ),
        number(
            "five_times_seated_sd",
            "s",
            "its standard deviation",
            read_entry("five_times", "to_fifth_seat_contact_sd_s"),
        ),
        number("cycle", "s", "mean time from stand to stand", read_entry("five_times", "mean_cycle_s")),
        count(
            "failed_attempts", "number of failed rises within this time", read_entry("five_times", "failed_attempts")
        ),
        *_model_errors("own", "own model minus measurement over the samples of the fit"),
        *_model_errors("held_out", "own model on left-out repetitions minus measurement"),
        *_model_errors("reference", "allometric body minus measurement, same samples"),
    ),
)
TABLES: Mapping[str, TableSchema] = {
    "trials": TRIALS,
    "lengths": TableSchema(
        "lengths.parquet",
        1,
        (
            _SUBJECT,
            text("segment", "shank (knee to ankle) or thigh (hip to knee)"),
            _REFERENCE,
            text("method", "framework = this program; stature = height times the factor in the allometric table"),
            _SUBJECTS,
            _TRIALS,
            number("length_mean", "m", "length by this method, mean"),
            number("length_sd", "m", "its standard deviation over the trials, for the cohort over the people"),
            number("reference_length", "m", "reference length, mean"),
            *_mean_sd("error", "%", f"method {_LENGTH_ERROR}; over trials, for the cohort over people"),
            _WHY,
        ),
    ),
    "strategies": TableSchema(
        "strategies.parquet",
        1,
        (
            _SUBJECT,
            _STRATEGY,
            _REFERENCE,
            _SUBJECTS,
            _TRIALS,
            *_mean_sd("shank_error", "%", f"shank {_LENGTH_ERROR}"),
            *_mean_sd("thigh_error", "%", f"thigh {_LENGTH_ERROR}"),
            *_mean_sd("reprojection", "m", SUMMARY_COLUMNS["reprojection"].meaning),
            *_mean_sd("condition_number", "1", SUMMARY_COLUMNS["condition_number"].meaning),
        ),
    ),
    "models": TableSchema(
        "models.parquet",
        1,
        (
            _SUBJECT,
            text("action", "strategy of the predicted trial"),
            text(
                "model",
                "own; own, held out (on left-out repetitions); a strategy (the body of another trial of the same "
                "person with this strategy); or the allometric table",
            ),
            text("action_trial", "the predicted trial; empty for the cohort"),
            text("model_trial", "the trial of the body; empty for the cohort and the allometric table"),
            _SUBJECTS,
            whole("pairs", "number of predictions in the row; each has the same weight"),
            count("samples", "number of compared samples, without contact to the seat"),
            *_mean_sd("condition_number", "1", "condition number of the chain's regressor of the predicted trial"),
            *(column for name, unit in SERIES.items() for column in _errors(name, unit, "model minus measurement")),
            number(
                "registration_residual", "m", "distance between the markers of the two trials after registration, rms"
            ),
            text("supported", "yes or no: whether the recordings support this transfer; empty if unknown"),
            text("codes", "codes of the reasons not to rely on the prediction"),
            _WHY,
        ),
        repeated=tuple(_mean_sd("tau_{k}", "N*m", "joint torque minus the torque of the predicted trial's own model")),
    ),
    "parameters": TableSchema(
        "parameters.parquet",
        1,
        (
            *TRIAL_COLUMNS,
            _STRATEGY,
            *_PARAMETER,
            number("value", "", "identified value, in `unit`"),
            number("sd", "", "its standard deviation, in `unit`"),
            text("verdict", "known, weak or not identifiable"),
            number("reference", "", "value for the allometric body on the same chain, in `unit`"),
        ),
    ),
    "variation": TableSchema(
        "variation.parquet",
        1,
        (
            _SUBJECT,
            text("set", "base, or modified: each (mx, my) replaced by its length mr"),
            *_PARAMETER,
            whole("segments", "number of segments of the chains with the base"),
            _SUBJECTS,
            _TRIALS,
            number("mean", "", "mean of the identified values over the trials, in `unit`"),
            number("sd", "", "their standard deviation, in `unit`"),
            number("cv", "1", "coefficient of variation, sd divided by the absolute mean; for the cohort its mean"),
            number("cv_sd", "1", "for the cohort: its standard deviation over the people"),
            number("reference_mean", "", "mean for the allometric body on the same chains, in `unit`"),
            number("reference_sd", "", "standard deviation for the allometric body, in `unit`"),
            number("reference_cv", "1", "coefficient of variation for the allometric body"),
            number("reference_cv_sd", "1", "for the cohort: its standard deviation over the people"),
            _WHY,
        ),
    ),
}
"""Schemas of the tables by name."""


def make_tables(trials: Sequence[TrialResult]) -> dict[str, ResultTable]:
    """Return the tables of a study by name."""
    rows = {
        "lengths": length_rows,
        "strategies": strategy_rows,
        "models": model_rows,
        "parameters": parameter_rows,
        "variation": variation_rows,
    }
    return fill_tables(TABLES, rows, trials)
