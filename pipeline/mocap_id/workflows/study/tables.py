"""The tables of a study: columns, units and meanings. Rows of the subject `cohort` are about all people together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from mocap_id.reporting.results.columns import ResultColumn as Column
from mocap_id.store import TableSchema
from mocap_id.workflows.study.trial_results import TrialResult
from mocap_id.workflows.transfer import SERIES

_SUBJECT = Column("subject", "str", "", "id of the person; `cohort` = all of them")
_STRATEGY = Column("strategy", "str", "", "how the person moves", lambda trial: trial.strategy)
_SUBJECTS = Column("subjects", "int64", "1", "how many people the row is about")
_TRIALS = Column("trials", "int64", "1", "how many trials the row is about")
_REFERENCE = Column(
    "reference",
    "str",
    "",
    "what lengths are held against: landmarks, or stature by an allometric table",
    lambda trial: trial.reference.kind,
)
_WHY = Column("why", "str", "", "why numbers are missing, or empty")
_PARTS = {"mean": "mean", "sd": "standard deviation", "rms": "root mean square"}


def _errors(name: str, unit: str, meaning: str, parts: tuple[str, ...] = ("mean", "sd", "rms")) -> list[Column]:
    return [Column(f"{name}_{part}", "float64", unit, f"{meaning}: {_PARTS[part]}") for part in parts]


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
        Column("trial", "str", "", "name of the trial and of its run folder", lambda trial: trial.name),
        Column("subject", "str", "", "id of the person", lambda trial: trial.subject),
        _STRATEGY,
        Column("verdict", "str", "", "ok, caution, refused, or failed where there is none", lambda trial: trial.level),
        Column("codes", "str", "", "codes of the verdict's reasons", lambda trial: ", ".join(trial.codes)),
        Column("exit_code", "int64", "1", "what `mocap-id run` would have ended with", lambda t: t.run.exit_code),
        Column("message", "str", "", "why it failed or was refused, without names of files", lambda t: t.run.published),
        Column("segments", "Int64", "1", "number of segments with the base", _summary("segments", "count")),
        Column("confidence", "float64", "1", "chance that the segments are right", _summary("segments", "confidence")),
        Column("shank", "float64", "m", "knee to ankle", lambda trial: trial.length("shank")),
        Column("shank_sd", "float64", "m", "standard deviation", _summary("lengths_m", "shank", "sd")),
        Column("thigh", "float64", "m", "hip to knee", lambda trial: trial.length("thigh")),
        Column("thigh_sd", "float64", "m", "standard deviation", _summary("lengths_m", "thigh", "sd")),
        _REFERENCE,
        Column(
            "shank_reference", "float64", "m", "the shank by this reference", lambda t: t.reference.lengths["shank"]
        ),
        Column(
            "thigh_reference", "float64", "m", "the thigh by this reference", lambda t: t.reference.lengths["thigh"]
        ),
        Column(
            "shank_error", "float64", "%", "shank less reference, of the reference", lambda t: t.length_error("shank")
        ),
        Column(
            "thigh_error", "float64", "%", "thigh less reference, of the reference", lambda t: t.length_error("thigh")
        ),
        Column(
            "reprojection",
            "float64",
            "m",
            "rms distance between measured and predicted markers",
            lambda trial: trial.metres("markers", "reprojection_rms_mm"),
        ),
        Column("missing_fraction", "float64", "1", "of the marker samples", _summary("markers", "missing_fraction")),
        Column(
            "mass", "float64", "kg", "what the plates show while the person stands", _summary("dynamics", "mass_kg")
        ),
        Column("samples", "Int64", "1", "that the model was fitted to", _summary("dynamics", "samples")),
        Column(
            "condition_number", "float64", "1", "of the regressor over them", _summary("dynamics", "condition_number")
        ),
        Column("clock_offset", "float64", "s", "plates after cameras", _summary("dynamics", "clock_offset_s")),
        Column("repetitions", "Int64", "1", "that were found", _repetitions),
        Column(
            "complete", "Int64", "1", "that have all their events", lambda trial: _repetitions(trial, complete=True)
        ),
        Column(
            "five_times",
            "float64",
            "s",
            "start of the first rise to the fifth stand",
            _summary("five_times", "to_fifth_stand_s"),
        ),
        Column(
            "five_times_seated",
            "float64",
            "s",
            "start of the first rise to the fifth seat contact",
            _summary("five_times", "to_fifth_seat_contact_s"),
        ),
        Column("cycle", "float64", "s", "from stand to stand, mean", _summary("five_times", "mean_cycle_s")),
        Column(
            "failed_attempts",
            "Int64",
            "1",
            "rises that were broken off within the time",
            _summary("five_times", "failed_attempts"),
        ),
        *_model_errors("own", "own model less measurement over the samples of the fit"),
        *_model_errors("held_out", "own model on repetitions left out, less measurement"),
        *_model_errors("reference", "allometric body less measurement, same samples"),
    ),
)

LENGTHS = TableSchema(
    "lengths.parquet",
    1,
    (
        _SUBJECT,
        Column("segment", "str", "", "shank (knee to ankle) or thigh (hip to knee)"),
        _REFERENCE,
        Column("method", "str", "", "framework = this program; stature = height times the table's share"),
        _SUBJECTS,
        _TRIALS,
        Column("length_mean", "float64", "m", "by this method"),
        Column("length_sd", "float64", "m", "standard deviation over the trials, of the cohort over the subjects"),
        Column("reference_length", "float64", "m", "by the reference, mean"),
        *_spread("error", "%", "method less reference, of the reference; over trials, of the cohort over subjects"),
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
        *_spread("shank_error", "%", "shank less reference, of the reference"),
        *_spread("thigh_error", "%", "thigh less reference, of the reference"),
        *_spread("reprojection", "m", "rms distance between measured and predicted markers"),
        *_spread("condition_number", "1", "of the regressor over the samples of the fit"),
    ),
)

MODELS = TableSchema(
    "models.parquet",
    1,
    (
        _SUBJECT,
        Column("action", "str", "", "strategy of the trial that is predicted"),
        Column(
            "model",
            "str",
            "",
            "own; own, held out (repetitions it was not fitted to); a strategy (the body of another trial of the same "
            "person that moved so); or the allometric table",
        ),
        Column("action_trial", "str", "", "the trial that is predicted; empty for the cohort"),
        Column("model_trial", "str", "", "the trial that the body comes from; empty for the cohort and the table"),
        _SUBJECTS,
        Column("pairs", "int64", "1", "how many predictions the row is about; each counts alike, whatever its samples"),
        Column("samples", "Int64", "1", "that are compared, off the seat"),
        *_spread("condition_number", "1", "of the regressor of the predicted trial"),
        *(column for name, unit in SERIES.items() for column in _errors(name, unit, "model less measurement")),
        Column("registration_residual", "float64", "m", "how far the markers of the two trials lie apart, rms"),
        Column("supported", "str", "", "yes or no: the recordings support this transfer; empty where not shown"),
        Column("codes", "str", "", "what to know before believing it: codes as of a verdict"),
        _WHY,
    ),
    repeated=tuple(_spread("tau_{k}", "N*m", "joint torque less that of the predicted trial's own model")),
)

VARIATION = TableSchema(
    "variation.parquet",
    1,
    (
        _SUBJECT,
        Column("set", "str", "", "base, or modified: each (mx, my) as its length mr"),
        Column("parameter", "str", "", "short name in the thesis's count: m1, mx1, mr2, I2 …"),
        Column("expression", "str", "", "what is regrouped in it"),
        Column("unit", "str", "", "kg, kg*m or kg*m^2"),
        Column("segments", "int64", "1", "of the chains, with the base"),
        _SUBJECTS,
        _TRIALS,
        Column("mean", "float64", "", "identified, over the trials, in `unit`"),
        Column("sd", "float64", "", "standard deviation over the trials, in `unit`"),
        Column("cv", "float64", "1", "coefficient of variation: sd over the mean's size; of the cohort the mean"),
        Column("cv_sd", "float64", "1", "of the cohort: standard deviation over the subjects"),
        Column("reference_mean", "float64", "", "of the allometric body on the same chains, in `unit`"),
        Column("reference_sd", "float64", "", "likewise, in `unit`"),
        Column("reference_cv", "float64", "1", "likewise"),
        Column("reference_cv_sd", "float64", "1", "likewise"),
        _WHY,
    ),
)

PARAMETERS = TableSchema(
    "parameters.parquet",
    1,
    (
        Column("trial", "str", "", "name of the trial"),
        Column("subject", "str", "", "id of the person"),
        _STRATEGY,
        Column("parameter", "str", "", "short name in the thesis's count"),
        Column("expression", "str", "", "what is regrouped in it"),
        Column("unit", "str", "", "kg, kg*m or kg*m^2"),
        Column("value", "float64", "", "identified, in `unit`"),
        Column("sd", "float64", "", "standard deviation, in `unit`"),
        Column("verdict", "str", "", "known, weak or not identifiable"),
        Column("reference", "float64", "", "of the allometric body on the same chain, in `unit`"),
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
