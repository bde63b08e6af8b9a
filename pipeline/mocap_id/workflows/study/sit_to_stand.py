"""The result of one trial of a study, with the reference lengths of the person."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.config.study import Person, Study, StudyTrial
from mocap_id.dynamics.allometry import TableName, look_up_table
from mocap_id.dynamics.comparison import Agreement
from mocap_id.errors import ConfigError
from mocap_id.reporting.contents import COHORT
from mocap_id.reporting.results.columns import ResultColumn as Column
from mocap_id.reporting.results.columns import ResultTable, count, number, text, whole
from mocap_id.store import Folder, TableSchema
from mocap_id.workflows.identified_trial import IdentifiedTrial, open_identified_trial
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.pooling import group_by, mean_sd, named_mean_sd, pool_errors
from mocap_id.workflows.transfer import (
    HELD_OUT,
    OWN,
    SERIES,
    TRANSFERRED,
    BodyErrors,
    apply_model,
    errors_at_home,
    rms_error,
)
from mocap_id.workflows.trial_outcome import (
    SUMMARY_COLUMNS,
    TRIAL_COLUMNS,
    VERDICT_COLUMNS,
    StudyOutcome,
    fill_tables,
    read_entry,
    read_summary,
)

SEGMENTS = ("shank", "thigh")
"""Segments whose lengths are compared with a reference."""
LANDMARKS = "landmarks"


@dataclass(frozen=True)
class LengthReference:
    """Reference for the segment lengths of a person."""

    kind: str  # ``landmarks``, or ``stature`` with the name of the allometric table; empty if there is no reference
    lengths: Mapping[str, float | None]  # reference lengths by segment, m; None if unknown
    by_stature: Mapping[str, float | None]  # lengths from height and allometric table, m; None if the height is unknown


@dataclass(frozen=True)
class BaseParameters:
    """The b base parameters of a trial."""

    symbols: tuple[str, ...]  # the first parameter in each expression: m1, mx1, mx2 …
    expressions: tuple[str, ...]
    units: tuple[str, ...]
    verdicts: tuple[str, ...]
    value: FloatArray  # (b,) NaN if unknown
    sd: FloatArray  # (b,) standard deviations; NaN if unknown
    reference: FloatArray  # (b,) values for the allometric body on the same chain; NaN if unknown
    segments: int  # number of segments of the chain, including the base


@dataclass(frozen=True, kw_only=True)
class TrialResult(StudyOutcome):
    """The result of one trial of a study."""

    reference: LengthReference
    identified: IdentifiedTrial | None  # None if the trial failed or was refused
    # errors of the trial's own model, in the fit and on left-out repetitions, and of the allometric body; empty if
    # the trial failed or was refused
    bodies: tuple[BodyErrors, ...]
    parameters: BaseParameters | None  # None if no parameter was identified

    @property
    def strategy(self) -> str:
        """Strategy of the movement."""
        return self.trial.strategy

    def length(self, segment: str) -> float | None:
        """Return the length of a segment, m; None if unknown."""
        length: float | None = self.value("lengths_m", segment, "value")
        return length

    def length_error(self, segment: str) -> float | None:
        """Return length minus reference length, % of the reference; None if one of the lengths is unknown."""
        length, reference = self.length(segment), self.reference.lengths[segment]
        return None if length is None or reference is None else 100 * (length / reference - 1)

    def model_errors(self, model: str) -> dict[str, tuple[float, float, float]]:
        """Return bias, standard deviation and root mean square of a model's error, by name of each known series.

        Parameters
        ----------
        model : {"own", "held_out", "reference"}
        """
        names = {OWN: "own", HELD_OUT: "held_out"}
        bodies = [body for body in self.bodies if names.get(body.name, "reference") == model]
        return {
            name: (error.bias, error.sd, math.hypot(error.bias, error.sd))
            for body in bodies
            for name, error in body.errors.items()
            if error is not None
        }


def read_trial_result(study: Study, trial: StudyTrial, run: TrialRun) -> TrialResult:
    """Read the result of a trial from its run folder."""
    out, passed = trial.trial.out, run.exit_code == 0
    identified = open_identified_trial(out) if passed else None
    settings: Any = trial.trial.settings["identify-dim"]
    return TrialResult(
        trial=trial,
        run=run,
        reference=find_length_reference(study.subjects[trial.subject], settings.reference),
        summary=read_summary(out, run),
        identified=identified,
        bodies=() if identified is None else errors_at_home(identified),
        parameters=_read_parameters(out) if passed else None,
    )


def find_length_reference(person: Person, name: TableName) -> LengthReference:
    """Return the reference for a person's lengths: landmarks if one of them is given, or else stature."""
    table = look_up_table(name, person.sex)
    by_stature = {
        segment: None if person.height is None else getattr(table, segment).length * person.height
        for segment in SEGMENTS
    }
    measured = {segment: getattr(person.landmarks_m, segment) for segment in SEGMENTS}
    if any(length is not None for length in measured.values()):
        return LengthReference(LANDMARKS, measured, by_stature)
    return LengthReference("" if person.height is None else f"stature ({name})", by_stature, by_stature)


def _read_parameters(out: Path) -> BaseParameters | None:
    """Read the base parameters from a run folder; None if no parameter except the mass was identified."""
    tree = Folder(out).tree("dynamics.h5")
    value, reference = tree.numbers("base/value"), tree.numbers("full/reference")
    if np.isfinite(value).sum() <= 1:  # the mass alone is not a model
        return None
    expressions = tree.texts("base/name")
    return BaseParameters(
        symbols=tuple(name.split("+")[0] for name in expressions),
        expressions=expressions,
        units=tree.texts("base/unit"),
        verdicts=tree.texts("base/verdict"),
        value=value,
        sd=tree.numbers("base/sd"),
        reference=tree.array("base/regrouping") @ reference,
        segments=len(reference) // 4,
    )


FRAMEWORK, STATURE = "framework", "stature"
_NO_REFERENCE = "neither landmarks_m nor height is given in the study's file"
_QUANTITIES: Mapping[str, Callable[[TrialResult], float | None]] = {
    "shank_error": lambda trial: trial.length_error("shank"),
    "thigh_error": lambda trial: trial.length_error("thigh"),
    "reprojection": lambda trial: trial.metres("markers", "reprojection_rms_mm"),
    "condition_number": lambda trial: trial.value("dynamics", "condition_number"),
}


def length_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `lengths`: first the rows of all people, then the rows of the cohort."""
    people = group_by(trials, lambda trial: trial.subject)
    rows = [row for segment in SEGMENTS for own in people.values() for row in _person_lengths(own, segment)]
    return [*rows, *_cohort_lengths(rows)]


def _person_lengths(trials: Sequence[TrialResult], segment: str) -> Iterator[dict[str, Any]]:
    reference = trials[0].reference
    known = [length for trial in trials if (length := trial.length(segment)) is not None]
    yield _length_row(trials[0], segment, FRAMEWORK, known)
    if reference.kind == LANDMARKS:
        by_stature = reference.by_stature[segment]
        yield _length_row(trials[0], segment, STATURE, [] if by_stature is None else [by_stature])


def _length_row(trial: TrialResult, segment: str, method: str, lengths: Sequence[float]) -> dict[str, Any]:
    reference = trial.reference.lengths[segment]
    errors = [math.nan] if reference is None else [100 * (length / reference - 1) for length in lengths]
    return {
        "subject": trial.subject,
        "segment": segment,
        "reference": trial.reference.kind,
        "method": method,
        "subjects": int(bool(lengths)),
        "trials": len(lengths) if method == FRAMEWORK else 0,
        **named_mean_sd("length", lengths),
        "reference_length": reference,
        **named_mean_sd("error", errors),
        "why": _explain_missing(trial, segment, method, lengths),
    }


def _explain_missing(trial: TrialResult, segment: str, method: str, lengths: Sequence[float]) -> str:
    """Return why a row has no error; empty if the error is known."""
    if trial.reference.kind == "":
        return _NO_REFERENCE
    if trial.reference.lengths[segment] is None:
        return f"landmarks_m does not give the {segment}"
    if not lengths:
        return "the height is not given" if method == STATURE else f"no trial has a {segment}"
    return ""


def _cohort_lengths(people: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield a row with mean and standard deviation over the people for each segment, reference and method."""
    known = [row for row in people if not row["why"]]
    keys = ("segment", "reference", "method")
    for group, rows in group_by(known, lambda row: tuple(row[key] for key in keys)).items():
        yield {
            **dict(zip(keys, group, strict=True)),
            "subject": COHORT,
            "subjects": len(rows),
            "trials": sum(row["trials"] for row in rows),
            **named_mean_sd("length", (row["length_mean"] for row in rows)),
            "reference_length": mean_sd(row["reference_length"] for row in rows)[0],
            **named_mean_sd("error", (row["error_mean"] for row in rows)),
        }


def strategy_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `strategies`: first the rows of all people, then the rows of the cohort."""
    identified = [trial for trial in trials if trial.identified is not None]
    groups = group_by(identified, lambda trial: (trial.subject, trial.strategy))
    subjects, strategies = (list(dict.fromkeys(key[k] for key in groups)) for k in (0, 1))
    rows = [
        _person_strategy(groups[subject, strategy])
        for subject in subjects
        for strategy in strategies
        if (subject, strategy) in groups
    ]
    return [*rows, *_cohort_strategies(rows)]


def _person_strategy(trials: Sequence[TrialResult]) -> dict[str, Any]:
    row: dict[str, Any] = {
        "subject": trials[0].subject,
        "strategy": trials[0].strategy,
        "reference": trials[0].reference.kind,
        "subjects": 1,
        "trials": len(trials),
    }
    for name, quantity in _QUANTITIES.items():
        row |= named_mean_sd(name, map(quantity, trials))
    return row


def _cohort_strategies(people: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield a row with mean and standard deviation over the people for each strategy and kind of reference."""
    for (strategy, reference), rows in group_by(people, lambda row: (row["strategy"], row["reference"])).items():
        row: dict[str, Any] = {
            "subject": COHORT,
            "strategy": strategy,
            "reference": reference,
            "subjects": len(rows),
            "trials": sum(person["trials"] for person in rows),
        }
        for name in _QUANTITIES:
            row |= named_mean_sd(name, (person[f"{name}_mean"] for person in rows))
        yield row


_OWN = (OWN, HELD_OUT)


def model_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `models`: first the rows of all people, then the rows of the cohort."""
    identified = [trial for trial in trials if trial.identified is not None]
    people = group_by(identified, lambda trial: trial.subject)
    rows = [row for trial in identified for row in _predict_trial(trial, people[trial.subject])]
    return [*rows, *_average_cohort(rows)]


def _predict_trial(action: TrialResult, same_person: Sequence[TrialResult]) -> Iterator[dict[str, Any]]:
    """Yield a row for each model that predicts the trial ``action``."""
    for body in action.bodies:
        yield _make_row(action, body.name, action.name if body.name in _OWN else "", body)
    for model in same_person:
        if model is not action:
            yield _transfer(action, model)


def _transfer(action: TrialResult, model: TrialResult) -> dict[str, Any]:
    """Return the row for the body of trial ``model`` on trial ``action``, or for why it cannot be transferred."""
    assert action.identified is not None and model.identified is not None
    name, source = model.strategy, model.name
    if not np.isfinite(model.identified.parameters).all():
        why = model.identified.facts.get("why") or "some of its full parameters are unknown"
        return _make_row(action, name, source, None, why=f"there is no body to transfer from {source}: {why}")
    try:
        result = apply_model(model.identified, action.identified)
    except ConfigError as error:  # the message begins with the trial's folder, which is not published
        return _make_row(action, name, source, None, why=str(error).removeprefix(f"{action.identified.source}: "))
    body = next(body for body in result.bodies if body.name == TRANSFERRED)
    return _make_row(action, name, source, body) | {
        "registration_residual": result.registration_residual,
        "supported": {True: "yes", False: "no", None: ""}[result.supported],
        "codes": ", ".join(reason.code for reason in result.reasons),
    }


def _make_row(action: TrialResult, name: str, source: str, body: BodyErrors | None, why: str = "") -> dict[str, Any]:
    assert action.identified is not None
    not_identified = action.identified.facts.get("why") if action.parameters is None else None
    row: dict[str, Any] = {
        "subject": action.subject,
        "action": action.strategy,
        "model": name,
        "action_trial": action.name,
        "model_trial": source,
        "subjects": 1,
        "pairs": int(body is not None and any(error is not None for error in body.errors.values())),
        "samples": int(action.identified.dynamics["in_fit"].sum()),
        "condition_number_mean": action.value("dynamics", "condition_number"),
        "why": why or (f"no parameters were identified on {action.name}: {not_identified}" if not_identified else ""),
    }
    if body is not None:
        for series, error in body.errors.items():
            row |= _bias_sd(series, error) | {f"{series}_rms": rms_error(error)}
        for j, torque in enumerate(body.torques, start=1):
            row |= _bias_sd(f"tau_{j}", torque)
    return row


def _bias_sd(name: str, error: Agreement | None) -> dict[str, float]:
    bias, sd = (math.nan, math.nan) if error is None else (error.bias, error.sd)
    return {f"{name}_mean": bias, f"{name}_sd": sd}


def _average_cohort(people: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield a row for each strategy and model, with the pooled errors of all people."""
    known = [row for row in people if math.isfinite(row.get("Fy_mean", math.nan))]
    torques = {name.removesuffix("_mean") for row in people for name in row if name.startswith("tau_")}
    series = [*SERIES, *sorted(name for name in torques if not name.endswith("_sd"))]
    for (action, model), rows in group_by(_sort(known), lambda row: (row["action"], row["model"])).items():
        row: dict[str, Any] = {
            "subject": COHORT,
            "action": action,
            "model": model,
            "subjects": len({one["subject"] for one in rows}),
            "pairs": len(rows),
            "samples": sum(one["samples"] for one in rows),
        }
        conditions = {one["action_trial"]: one["condition_number_mean"] for one in rows}
        row |= named_mean_sd("condition_number", conditions.values())
        for name in series:
            mean, sd = pool_errors([_read_agreement(one, name) for one in rows])
            row |= {f"{name}_mean": mean, f"{name}_sd": sd}
            if name in SERIES:
                row[f"{name}_rms"] = math.hypot(mean, sd)
        yield row


def _sort(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return rows sorted by strategy, then: allometric body, own model, models of other trials by their strategy."""
    actions = list(dict.fromkeys(row["action"] for row in rows))

    def rank(row: Mapping[str, Any]) -> tuple[int, int, int]:
        transferred = row["model"] not in _OWN and bool(row["model_trial"])
        kind = 2 if transferred else 1 if row["model"] in _OWN else 0
        other = actions.index(row["model"]) if transferred and row["model"] in actions else 0
        return actions.index(row["action"]), kind, other + (row["model"] == HELD_OUT)

    return sorted(rows, key=rank)


def _read_agreement(row: Mapping[str, Any], name: str) -> Agreement | None:
    bias, sd = row.get(f"{name}_mean", math.nan), row.get(f"{name}_sd", math.nan)
    return Agreement(bias, sd, math.nan) if math.isfinite(bias) and math.isfinite(sd) else None


_ROUNDING = 1e-9  # kg, kg m, kg m²: the allometric body has its masses on the lines between the joints
_GROUP = ("set", "parameter", "expression", "unit", "segments")


@dataclass(frozen=True)
class ParameterValue:
    """One parameter of a trial."""

    symbol: str
    expression: str  # the parameters that are regrouped into this parameter
    unit: str
    value: float
    reference: float  # value for the allometric body


def parameter_rows(trials: Sequence[TrialResult]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table `parameters`: one for each base parameter of each trial."""
    for trial in trials:
        parameters = trial.parameters
        if parameters is None:
            continue
        labels = {"trial": trial.name, "subject": trial.subject, "strategy": trial.strategy}
        for one, sd, verdict in zip(_base(parameters), parameters.sd, parameters.verdicts, strict=True):
            yield labels | {
                "parameter": one.symbol,
                "expression": one.expression,
                "unit": one.unit,
                "value": one.value,
                "sd": float(sd),
                "verdict": verdict,
                "reference": one.reference,
            }


def variation_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `variation`: first the rows of all people, then the rows of the cohort."""
    rows = [
        row
        for subject, own in group_by(trials, lambda trial: trial.subject).items()
        for row in _person(subject, [trial.parameters for trial in own if trial.parameters is not None])
    ]
    return [*rows, *_cohort(rows)]


def _base(parameters: BaseParameters) -> list[ParameterValue]:
    columns = (parameters.symbols, parameters.expressions, parameters.units, parameters.value, parameters.reference)
    return [
        ParameterValue(symbol, expression, unit, float(value), float(reference))
        for symbol, expression, unit, value, reference in zip(*columns, strict=True)
    ]


def _modify(parameters: BaseParameters) -> list[ParameterValue]:
    """Return the modified parameters, in which the length mr replaces each pair (mx, my)."""
    by_symbol = {parameter.symbol: parameter for parameter in _base(parameters)}
    modified = []
    for symbol, mx in by_symbol.items():
        my = by_symbol.get(symbol.replace("mx", "my")) if symbol.startswith("mx") else None
        if my is not None:
            value, reference = math.hypot(mx.value, my.value), math.hypot(mx.reference, my.reference)
            expression = f"|({mx.expression}, {my.expression})|"
            modified.append(ParameterValue(symbol.replace("mx", "mr"), expression, mx.unit, value, reference))
        elif not (symbol.startswith("my") and symbol.replace("my", "mx") in by_symbol):
            modified.append(mx)
    return modified


def _person(subject: str, trials: Sequence[BaseParameters]) -> Iterator[dict[str, Any]]:
    """Yield a person's rows, from the trials whose chains have the most frequent number of segments."""
    if not trials:
        return
    segments = Counter(trial.segments for trial in trials).most_common(1)[0][0]
    counted = [trial for trial in trials if trial.segments == segments]
    left_out = len(trials) - len(counted)
    why = f"trials with a different number of segments, which do not count: {left_out}" if left_out else ""
    for kind, read in (("base", _base), ("modified", _modify)):
        for same in zip(*map(read, counted), strict=True):
            yield {
                "subject": subject,
                "set": kind,
                "parameter": same[0].symbol,
                "expression": same[0].expression,
                "unit": same[0].unit,
                "segments": segments,
                "subjects": 1,
                "trials": len(counted),
                **_variation("", [parameter.value for parameter in same]),
                **_variation("reference_", [parameter.reference for parameter in same]),
                "why": why if len(counted) > 1 else "a single trial has no variation",
            }


def _variation(prefix: str, values: Sequence[float]) -> dict[str, float]:
    """Return the columns mean, sd and cv; the coefficient of variation cv is NaN if the mean is zero."""
    mean, sd = mean_sd(values)
    cv = sd / abs(mean) if abs(mean) > _ROUNDING else math.nan
    return {f"{prefix}mean": mean, f"{prefix}sd": sd, f"{prefix}cv": cv}


def _cohort(people: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield rows with mean and standard deviation of the people's coefficients of variation."""
    known = [row for row in people if row["trials"] > 1]
    for group, rows in group_by(known, lambda row: tuple(row[name] for name in _GROUP)).items():
        cv, reference = mean_sd(row["cv"] for row in rows), mean_sd(row["reference_cv"] for row in rows)
        yield {
            **dict(zip(_GROUP, group, strict=True)),
            "subject": COHORT,
            "subjects": len(rows),
            "trials": sum(row["trials"] for row in rows),
            "cv": cv[0],
            "cv_sd": cv[1],
            "reference_cv": reference[0],
            "reference_cv_sd": reference[1],
        }


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
