"""The tables of a study: their columns, units and meanings. In each, the subject `cohort` is all of them together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd

from mocap_id.store import Column, TableSchema
from mocap_id.store.parquet import columns_of

_SUBJECT = Column("subject", "str", "", "id of the person; `cohort` = all of them")
_STRATEGY = Column("strategy", "str", "", "how the person moves")
_SUBJECTS = Column("subjects", "int64", "1", "how many people the row is about")
_TRIALS = Column("trials", "int64", "1", "how many trials the row is about")
_REFERENCE = Column(
    "reference", "str", "", "what lengths are held against: landmarks, or stature by an allometric table"
)
_WHY = Column("why", "str", "", "why numbers are missing, or empty")


def _error(name: str, unit: str, what: str, *, rms: bool = True) -> tuple[Column, ...]:
    columns = (
        Column(f"{name}_mean", "float64", unit, f"{what}: mean"),
        Column(f"{name}_sd", "float64", unit, f"{what}: standard deviation"),
    )
    return (*columns, Column(f"{name}_rms", "float64", unit, f"{what}: root mean square")) if rms else columns


def _spread(name: str, unit: str, what: str) -> tuple[Column, ...]:
    return _error(name, unit, what, rms=False)


_SERIES = (("Fx", "N"), ("Fy", "N"), ("tauz", "N*m"), ("cop_x", "m"))

TRIALS = TableSchema(
    "trials.parquet",
    1,
    (
        Column("trial", "str", "", "name of the trial and of its run folder"),
        Column("subject", "str", "", "id of the person"),
        _STRATEGY,
        Column("verdict", "str", "", "ok, caution, refused, or failed where there is none"),
        Column("codes", "str", "", "codes of the verdict's reasons"),
        Column("exit_code", "int64", "1", "what `mocap-id run` would have ended with"),
        Column("message", "str", "", "why it failed or was refused, without names of files"),
        Column("segments", "Int64", "1", "number of segments with the base"),
        Column("confidence", "float64", "1", "chance that the segments are right"),
        Column("shank", "float64", "m", "knee to ankle"),
        Column("shank_sd", "float64", "m", "standard deviation"),
        Column("thigh", "float64", "m", "hip to knee"),
        Column("thigh_sd", "float64", "m", "standard deviation"),
        _REFERENCE,
        Column("shank_reference", "float64", "m", "the shank by this reference"),
        Column("thigh_reference", "float64", "m", "the thigh by this reference"),
        Column("shank_error", "float64", "%", "shank less reference, of the reference"),
        Column("thigh_error", "float64", "%", "thigh less reference, of the reference"),
        Column("reprojection", "float64", "m", "rms distance between measured and predicted markers"),
        Column("missing_fraction", "float64", "1", "of the marker samples"),
        Column("mass", "float64", "kg", "what the plates show while the person stands"),
        Column("samples", "Int64", "1", "that the model was fitted to"),
        Column("condition_number", "float64", "1", "of the regressor over them"),
        Column("clock_offset", "float64", "s", "plates after cameras"),
        Column("repetitions", "Int64", "1", "that were found"),
        Column("complete", "Int64", "1", "that have all their events"),
        Column("five_times", "float64", "s", "start of the first rise to the fifth stand"),
        Column("five_times_seated", "float64", "s", "start of the first rise to the fifth seat contact"),
        Column("cycle", "float64", "s", "from stand to stand, mean"),
        Column("failed_attempts", "Int64", "1", "rises that were broken off within the time"),
        *(
            column
            for name, unit in _SERIES
            for column in _error(f"{name}_own", unit, "own model less measurement over the samples of the fit")
        ),
        *(
            column
            for name, unit in _SERIES
            for column in _error(f"{name}_held_out", unit, "own model on repetitions left out, less measurement")
        ),
        *(
            column
            for name, unit in _SERIES
            for column in _error(f"{name}_reference", unit, "allometric body less measurement, same samples")
        ),
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
        *(column for name, unit in _SERIES for column in _error(name, unit, "model less measurement")),
        Column("registration_residual", "float64", "m", "how far the markers of the two trials lie apart, rms"),
        Column("supported", "str", "", "yes or no: the recordings support this transfer; empty where not shown"),
        Column("codes", "str", "", "what to know before believing it: codes as of a verdict"),
        _WHY,
    ),
    repeated=_spread("tau_{k}", "N*m", "joint torque less that of the predicted trial's own model"),
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
        Column(
            "cv",
            "float64",
            "1",
            "coefficient of variation: sd over the mean's size; of the cohort the mean",
        ),
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
"""By the stem of their files."""


def frame(schema: TableSchema, rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Rows as a table with exactly the schema's columns and types; what a row does not name is missing."""
    rows = list(rows)
    given = [name for row in rows for name in row]
    columns = list(columns_of(schema, [*given, *(column.name for column in schema.columns)]))
    unknown = set(given) - {column.name for column in columns}
    if unknown:
        raise ValueError(f"{schema.file} has no columns {sorted(unknown)}")
    missing = {"str": "", "float64": float("nan"), "Int64": pd.NA}
    data = {}
    for column in columns:
        values = [row.get(column.name) for row in rows]
        filled = [missing.get(column.dtype) if value is None else value for value in values]
        data[column.name] = pd.Series(filled, dtype=column.dtype)
    return pd.DataFrame(data)
