"""The tables of a study: columns, units and meanings. Rows of the subject `cohort` are about all people together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from mocap_id.reporting.results.columns import ResultColumn as Column
from mocap_id.reporting.results.columns import count, number, text, whole
from mocap_id.store import TableSchema
from mocap_id.workflows.study.study_outcome import TRIAL_COLUMNS, VERDICT_COLUMNS
from mocap_id.workflows.study.trial_results import TrialResult
from mocap_id.workflows.transfer import SERIES

_SUBJECT = text("subject", "id of the person; `cohort` = all people")
_STRATEGY = text("strategy", "how the person moves", lambda trial: trial.strategy)
_SUBJECTS = whole("subjects", "number of people in the row")
_TRIALS = whole("trials", "number of trials in the row")
_REFERENCE = text(
    "reference",
    "reference of the lengths: landmarks, or stature by an allometric table",
    lambda trial: trial.reference.kind,
)
_WHY = text("why", "why numbers are missing; else empty")
_PARTS = {"mean": "mean", "sd": "standard deviation", "rms": "root mean square"}


def _errors(name: str, unit: str, meaning: str, parts: tuple[str, ...] = ("mean", "sd", "rms")) -> list[Column]:
    return [number(f"{name}_{part}", unit, f"{meaning}: {_PARTS[part]}") for part in parts]


def _spread(name: str, unit: str, meaning: str) -> list[Column]:
    return _errors(name, unit, meaning, ("mean", "sd"))


def _summary(*keys: str) -> Callable[[TrialResult], Any]:
    return lambda trial: trial.value(*keys)


def _repetitions(trial: TrialResult, *, complete: bool = False) -> int | None:
    found = trial.value("repetitions")
    return None if found is None else sum(bool(one["complete"]) or not complete for one in found)


def _model_errors(model: str, meaning: str) -> Iterator[Column]:
    def value(name: str, part: int) -> Callable[[TrialResult], float | None]:
        return lambda trial: trial.model_errors(model).get(name, (None, None, None))[part]

    for name, unit in SERIES.items():
        for part, column in enumerate(_errors(f"{name}_{model}", unit, meaning)):
            yield Column(column.name, column.dtype, unit, column.meaning, value(name, part))


TRIALS = TableSchema(
    "trials.parquet",
    1,
    (
        *TRIAL_COLUMNS,
        _STRATEGY,
        *VERDICT_COLUMNS,
        count("segments", "number of segments with the base", _summary("segments", "count")),
        number("confidence", "1", "probability that the segments are right", _summary("segments", "confidence")),
        number("shank", "m", "length of the shank, knee to ankle", lambda trial: trial.length("shank")),
        number("shank_sd", "m", "its standard deviation", _summary("lengths_m", "shank", "sd")),
        number("thigh", "m", "length of the thigh, hip to knee", lambda trial: trial.length("thigh")),
        number("thigh_sd", "m", "its standard deviation", _summary("lengths_m", "thigh", "sd")),
        _REFERENCE,
        number("shank_reference", "m", "length of the shank by the reference", lambda t: t.reference.lengths["shank"]),
        number("thigh_reference", "m", "length of the thigh by the reference", lambda t: t.reference.lengths["thigh"]),
        number(
            "shank_error", "%", "shank minus reference, relative to the reference", lambda t: t.length_error("shank")
        ),
        number(
            "thigh_error", "%", "thigh minus reference, relative to the reference", lambda t: t.length_error("thigh")
        ),
        number(
            "reprojection",
            "m",
            "rms distance between measured and predicted markers",
            lambda trial: trial.metres("markers", "reprojection_rms_mm"),
        ),
        number("missing_fraction", "1", "share of missing marker samples", _summary("markers", "missing_fraction")),
        number("mass", "kg", "mass that the plates measure while the person stands", _summary("dynamics", "mass_kg")),
        count("samples", "number of samples of the fit", _summary("dynamics", "samples")),
        number(
            "condition_number",
            "1",
            "condition number of the regressor over these samples",
            _summary("dynamics", "condition_number"),
        ),
        number("clock_offset", "s", "clock offset, plates after cameras", _summary("dynamics", "clock_offset_s")),
        count("repetitions", "number of repetitions found", _repetitions),
        count(
            "complete", "number of repetitions with all their events", lambda trial: _repetitions(trial, complete=True)
        ),
        number(
            "five_times",
            "s",
            "time from the start of the first rise to the fifth stand",
            _summary("five_times", "to_fifth_stand_s"),
        ),
        number(
            "five_times_seated",
            "s",
            "time from the start of the first rise to the fifth seat contact",
            _summary("five_times", "to_fifth_seat_contact_s"),
        ),
        number("cycle", "s", "mean time from stand to stand", _summary("five_times", "mean_cycle_s")),
        count("failed_attempts", "number of failed rises within this time", _summary("five_times", "failed_attempts")),
        *_model_errors("own", "own model minus measurement over the samples of the fit"),
        *_model_errors("held_out", "own model on left-out repetitions minus measurement"),
        *_model_errors("reference", "allometric body minus measurement, same samples"),
    ),
)

LENGTHS = TableSchema(
    "lengths.parquet",
    1,
    (
        _SUBJECT,
        text("segment", "shank (knee to ankle) or thigh (hip to knee)"),
        _REFERENCE,
        text("method", "framework = this program; stature = height times the table's share"),
        _SUBJECTS,
        _TRIALS,
        number("length_mean", "m", "length by this method, mean"),
        number("length_sd", "m", "its standard deviation over the trials, for the cohort over the people"),
        number("reference_length", "m", "length by the reference, mean"),
        *_spread(
            "error", "%", "method minus reference, relative to the reference; over trials, for the cohort over people"
        ),
        _WHY,
    ),
)

STRATEGIES = TableSchema(
    "strategies.parquet",
    1,
    (
        _SUBJECT,
        _STRATEGY,
        _REFERENCE,
        _SUBJECTS,
        _TRIALS,
        *_spread("shank_error", "%", "shank minus reference, relative to the reference"),
        *_spread("thigh_error", "%", "thigh minus reference, relative to the reference"),
        *_spread("reprojection", "m", "rms distance between measured and predicted markers"),
        *_spread("condition_number", "1", "condition number of the regressor over the samples of the fit"),
    ),
)

MODELS = TableSchema(
    "models.parquet",
    1,
    (
        _SUBJECT,
        text("action", "strategy of the predicted trial"),
        text(
            "model",
            "own; own, held out (on left-out repetitions); a strategy (the body of another trial of the same person "
            "with this strategy); or the allometric table",
        ),
        text("action_trial", "the predicted trial; empty for the cohort"),
        text("model_trial", "the trial of the body; empty for the cohort and the allometric table"),
        _SUBJECTS,
        whole("pairs", "number of predictions in the row; each has the same weight"),
        count("samples", "number of compared samples, off the seat"),
        *_spread("condition_number", "1", "condition number of the regressor of the predicted trial"),
        *(column for name, unit in SERIES.items() for column in _errors(name, unit, "model minus measurement")),
        number("registration_residual", "m", "distance between the markers of the two trials after registration, rms"),
        text("supported", "yes or no: whether the recordings support this transfer; empty if not known"),
        text("codes", "codes of the reasons not to rely on the prediction"),
        _WHY,
    ),
    repeated=tuple(_spread("tau_{k}", "N*m", "joint torque minus that of the predicted trial's own model")),
)

VARIATION = TableSchema(
    "variation.parquet",
    1,
    (
        _SUBJECT,
        text("set", "base, or modified: each (mx, my) as its length mr"),
        text("parameter", "short name as in the thesis: m1, mx1, mr2, I2 …"),
        text("expression", "the parameters regrouped in it"),
        text("unit", "kg, kg*m or kg*m^2"),
        whole("segments", "number of segments of the chains with the base"),
        _SUBJECTS,
        _TRIALS,
        number("mean", "", "mean of the identified values over the trials, in `unit`"),
        number("sd", "", "their standard deviation, in `unit`"),
        number("cv", "1", "coefficient of variation, sd over absolute mean; for the cohort its mean"),
        number("cv_sd", "1", "for the cohort: its standard deviation over the people"),
        number("reference_mean", "", "mean for the allometric body on the same chains, in `unit`"),
        number("reference_sd", "", "standard deviation for the allometric body, in `unit`"),
        number("reference_cv", "1", "coefficient of variation for the allometric body"),
        number("reference_cv_sd", "1", "for the cohort: its standard deviation over the people"),
        _WHY,
    ),
)

PARAMETERS = TableSchema(
    "parameters.parquet",
    1,
    (
        text("trial", "name of the trial"),
        text("subject", "id of the person"),
        _STRATEGY,
        text("parameter", "short name as in the thesis"),
        text("expression", "the parameters regrouped in it"),
        text("unit", "kg, kg*m or kg*m^2"),
        number("value", "", "identified value, in `unit`"),
        number("sd", "", "its standard deviation, in `unit`"),
        text("verdict", "known, weak or not identifiable"),
        number("reference", "", "value for the allometric body on the same chain, in `unit`"),
    ),
)

TABLES: Mapping[str, TableSchema] = {
    "trials": TRIALS,
    "lengths": LENGTHS,
    "strategies": STRATEGIES,
    "models": MODELS,
    "parameters": PARAMETERS,
    "variation": VARIATION,
}
"""The schemas by table name."""
