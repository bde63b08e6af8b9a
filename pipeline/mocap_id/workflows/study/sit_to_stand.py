"""A study of sit-to-stand trials of several people with several strategies (thesis 6, tables 6.1 to 6.3, figure 6.8).

From top to bottom: the result of a trial; the rows of the tables `lengths`, `strategies`, `models`, `parameters` and
`variation`; the columns of all tables. Rows with the subject `cohort` are about all people together.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from mocap_id.config.study import Person, Study, StudyTrial
from mocap_id.dynamics.prediction import Agreement
from mocap_id.dynamics.priors import TableName, look_up_table
from mocap_id.dynamics.regressor import PLANAR_PARAMETERS
from mocap_id.errors import ConfigError
from mocap_id.protocols.five_times import FiveTimes
from mocap_id.reporting import COHORT
from mocap_id.reporting.grids import UNKNOWN, millimetres, scale, show, show_fixed, to_number
from mocap_id.reporting.results import (
    ResultColumn,
    count,
    declare_tables,
    error_columns,
    number,
    shown_as,
    text,
    whole,
)
from mocap_id.reporting.study.sit_to_stand import render_cohort_page
from mocap_id.results import list_quantities
from mocap_id.store import Folder
from mocap_id.workflows.identified_trial import IdentifiedTrial, open_identified_trial
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.study.study import StudyKind, find_mean_sd, group_by, named_mean_sd, pool_errors, pool_people
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
    read_entry,
    read_summary,
)

SEGMENTS = {"shank": "knee to ankle", "thigh": "hip to knee"}
"""Segments whose lengths are compared with a reference."""
LANDMARKS = "landmarks"
FRAMEWORK, STATURE = "framework", "stature"
_OWN = (OWN, HELD_OUT)
_ROUNDING = 1e-9  # kg, kg m, kg m²: the allometric body has its masses on the lines between the joints


@dataclass(frozen=True, kw_only=True)
class TrialResult(StudyOutcome):
    """The result of one trial of a study."""

    reference: str  # ``landmarks``, or ``stature`` with the name of the allometric table; empty without a reference
    reference_lengths: Mapping[str, float | None]  # by segment, m; None if unknown
    lengths_by_stature: Mapping[str, float | None]  # from height and allometric table, m; None if the height is unknown
    identified: IdentifiedTrial | None  # None if the trial failed or was refused
    # errors of the trial's own model, in the fit and on left-out repetitions, and of the allometric body; empty if
    # the trial failed or was refused
    bodies: tuple[BodyErrors, ...]
    parameters: Sequence[Mapping[str, Any]]  # their rows of the table `parameters`; empty if none was identified
    segments: int = 0  # number of segments of the chain with these parameters, including the base

    @property
    def strategy(self) -> str:
        return self.trial.strategy

    def length(self, segment: str) -> float | None:
        """Return the length of a segment, m; None if unknown."""
        length: float | None = self.value("lengths_m", segment, "value")
        return length

    def length_error(self, segment: str) -> float | None:
        """Return length minus reference length, % of the reference; None if one of the lengths is unknown."""
        length, reference = self.length(segment), self.reference_lengths[segment]
        return None if length is None or reference is None else 100 * (length / reference - 1)


def _read_result(study: Study, trial: StudyTrial, run: TrialRun) -> TrialResult:
    out, passed = trial.trial.out, run.exit_code == 0
    identified = open_identified_trial(out) if passed else None
    settings: Any = trial.trial.settings["identify-dim"]
    parameters: list[dict[str, Any]] = []
    segments = 0
    if passed:
        tree = Folder(out).tree("dynamics.h5")
        value, full = tree.numbers("base/value"), tree.numbers("full/reference")
        if np.isfinite(value).sum() > 1:  # the mass alone is not a model
            expressions = tree.texts("base/name")
            columns = {
                "parameter": [name.split("+")[0] for name in expressions],
                "expression": expressions,
                "unit": tree.texts("base/unit"),
                "value": value.tolist(),
                "sd": tree.numbers("base/sd").tolist(),
                "verdict": tree.texts("base/verdict"),
                "reference": (tree.array("base/regrouping") @ full).tolist(),  # of the allometric body
            }
            parameters = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
            segments = len(full) // len(PLANAR_PARAMETERS)
    reference, lengths, by_stature = find_length_reference(study.subjects[trial.subject], settings.reference)
    return TrialResult(
        trial=trial,
        run=run,
        reference=reference,
        reference_lengths=lengths,
        lengths_by_stature=by_stature,
        summary=read_summary(out, run),
        identified=identified,
        bodies=() if identified is None else errors_at_home(identified),
        parameters=parameters,
        segments=segments,
    )


def find_length_reference(
    person: Person, name: TableName
) -> tuple[str, Mapping[str, float | None], Mapping[str, float | None]]:
    """Return the kind of a person's reference lengths, the lengths, and the lengths by stature, as in TrialResult.

    The reference is the landmarks if one of them is given, or else stature.
    """
    table = look_up_table(name, person.sex)
    by_stature = {
        segment: None if person.height is None else getattr(table, segment).length * person.height
        for segment in SEGMENTS
    }
    measured = {segment: getattr(person.landmarks_m, segment) for segment in SEGMENTS}
    if any(length is not None for length in measured.values()):
        return LANDMARKS, measured, by_stature
    return "" if person.height is None else f"stature ({name})", by_stature, by_stature


# Lengths and results by strategy (tables 6.1 and 6.2).


def length_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `lengths`: first the rows of all people, then the rows of the cohort.

    Beside the lengths of a person with landmarks, there is a row of the length by stature.
    """
    rows = []
    for segment, (subject, own) in product(SEGMENTS, group_by(trials, lambda trial: trial.subject).items()):
        kind, reference = own[0].reference, own[0].reference_lengths[segment]
        methods = {FRAMEWORK: [length for trial in own if (length := trial.length(segment)) is not None]}
        if kind == LANDMARKS:
            by_stature = own[0].lengths_by_stature[segment]
            methods[STATURE] = [] if by_stature is None else [by_stature]
        for method, lengths in methods.items():
            errors = [math.nan] if reference is None else [100 * (length / reference - 1) for length in lengths]
            why = ""
            if kind == "":
                why = "neither landmarks_m nor height is given in the study's file"
            elif reference is None:
                why = f"landmarks_m does not give the {segment}"
            elif not lengths:
                why = "the height is not given" if method == STATURE else f"no trial has a {segment}"
            row: dict[str, Any] = {
                "subject": subject,
                "segment": segment,
                "reference": kind,
                "method": method,
                "subjects": int(bool(lengths)),
                "trials": len(lengths) if method == FRAMEWORK else 0,
                **named_mean_sd("length", lengths),
                "reference_length": reference,
                **named_mean_sd("error", errors),
                "why": why,
            }
            rows.append(row)
    known = [row for row in rows if not row["why"]]
    means = {name: (name, name.replace("mean", "sd")) for name in ("length_mean", "error_mean")}
    means["reference_length"] = ("reference_length", "")
    return [*rows, *pool_people(known, ("segment", "reference", "method"), means)]


def strategy_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `strategies`: first the rows of all people, then the rows of the cohort."""
    identified = [trial for trial in trials if trial.identified is not None]
    groups = group_by(identified, lambda trial: (trial.subject, trial.strategy))
    subjects, strategies = (list(dict.fromkeys(key[k] for key in groups)) for k in (0, 1))
    rows = []
    for subject, strategy in product(subjects, strategies):
        own = groups.get((subject, strategy), [])
        if own:
            labels: dict[str, Any] = {"subject": subject, "strategy": strategy, "reference": own[0].reference}
            rows.append(
                labels
                | {"subjects": 1, "trials": len(own)}
                | named_mean_sd("shank_error", [trial.length_error("shank") for trial in own])
                | named_mean_sd("thigh_error", [trial.length_error("thigh") for trial in own])
                | named_mean_sd("reprojection", [trial.metres("markers", "reprojection_rms_mm") for trial in own])
                | named_mean_sd("condition_number", [trial.value("dynamics", "condition_number") for trial in own])
            )
    names = [name for row in rows[:1] for name in row if name.endswith("_mean")]
    means = {name: (name, name.replace("_mean", "_sd")) for name in names}
    return [*rows, *pool_people(rows, ("strategy", "reference"), means)]


# Every model of a person applied to every trial of the same person (table 6.3).


def model_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `models`: first the rows of all people, then the rows of the cohort."""
    identified = [trial for trial in trials if trial.identified is not None]
    people = group_by(identified, lambda trial: trial.subject)
    rows = []
    for action in identified:
        assert action.identified is not None
        not_identified = None if action.parameters else action.identified.facts.get("why")
        labels: dict[str, Any] = {
            "subject": action.subject,
            "action": action.strategy,
            "action_trial": action.name,
            "subjects": 1,
            "pairs": 0,
            "samples": int(action.identified.dynamics["in_fit"].sum()),
            "condition_number_mean": action.value("dynamics", "condition_number"),
            "why": f"no parameters were identified on {action.name}: {not_identified}" if not_identified else "",
        }
        for body in action.bodies:
            own = {"model": body.name, "model_trial": action.name if body.name in _OWN else ""}
            rows.append(labels | own | _describe_errors(body))
        for model in people[action.subject]:
            if model is action:
                continue
            assert model.identified is not None
            row = labels | {"model": model.strategy, "model_trial": model.name}
            if np.isfinite(model.identified.parameters).all():
                try:
                    result = apply_model(model.identified, action.identified)
                except ConfigError as error:  # the message begins with the trial's folder, which is not published
                    row["why"] = str(error).removeprefix(f"{action.identified.source}: ")
                else:
                    row |= _describe_errors(next(body for body in result.bodies if body.name == TRANSFERRED))
                    row["registration_residual"] = result.registration_residual
                    row["supported"] = {True: "yes", False: "no", None: ""}[result.supported]
                    row["codes"] = ", ".join(reason.code for reason in result.reasons)
            else:
                why = model.identified.facts.get("why") or "some of its full parameters are unknown"
                row["why"] = f"there is no body to transfer from {model.name}: {why}"
            rows.append(row)
    return [*rows, *_pool_predictions(rows)]


def _describe_errors(body: BodyErrors) -> dict[str, Any]:
    """Return the columns of a body's errors."""
    row: dict[str, Any] = {"pairs": int(any(error is not None for error in body.errors.values()))}
    torques = {f"tau_{j}": torque for j, torque in enumerate(body.torques, start=1)}
    for name, error in {**body.errors, **torques}.items():
        bias, sd = (math.nan, math.nan) if error is None else (error.bias, error.sd)
        row |= {f"{name}_mean": bias, f"{name}_sd": sd}
    return row | {f"{name}_rms": rms_error(error) for name, error in body.errors.items()}


def _pool_predictions(people: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield a row for each strategy, and in it for the allometric body, own model, and models of other strategies."""
    known = [row for row in people if math.isfinite(row.get("Fy_mean", math.nan))]
    actions = list(dict.fromkeys(row["action"] for row in known))

    def rank(row: Mapping[str, Any]) -> tuple[int, int, int]:
        transferred = row["model"] not in _OWN and bool(row["model_trial"])
        kind = 2 if transferred else 1 if row["model"] in _OWN else 0
        other = actions.index(row["model"]) if transferred and row["model"] in actions else 0
        return actions.index(row["action"]), kind, other + (row["model"] == HELD_OUT)

    def read_error(row: Mapping[str, Any], name: str) -> Agreement | None:
        bias, sd = row.get(f"{name}_mean", math.nan), row.get(f"{name}_sd", math.nan)
        return Agreement(bias, sd, math.nan) if math.isfinite(bias) and math.isfinite(sd) else None

    torques = {name.removesuffix("_mean") for row in people for name in row if name.startswith("tau_")}
    series = [*SERIES, *sorted(name for name in torques if not name.endswith("_sd"))]
    for (action, model), rows in group_by(sorted(known, key=rank), lambda row: (row["action"], row["model"])).items():
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
            mean, sd = pool_errors([read_error(one, name) for one in rows])
            row |= {f"{name}_mean": mean, f"{name}_sd": sd}
            if name in SERIES:
                row[f"{name}_rms"] = math.hypot(mean, sd)
        yield row


# Base parameters, and their variation over trials (figure 6.8).


def parameter_rows(trials: Sequence[TrialResult]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table: one for each base parameter of each trial."""
    for trial in trials:
        labels = {"trial": trial.name, "subject": trial.subject, "strategy": trial.strategy}
        yield from (labels | dict(one) for one in trial.parameters)


def variation_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `variation`: first the rows of all people, then the rows of the cohort.

    A person's rows are from the trials whose chains have the most frequent number of segments.
    """
    rows = []
    for subject, every in group_by(trials, lambda trial: trial.subject).items():
        own = [trial for trial in every if trial.parameters]
        if not own:
            continue
        segments = Counter(trial.segments for trial in own).most_common(1)[0][0]
        counted = [trial.parameters for trial in own if trial.segments == segments]
        left_out = len(own) - len(counted)
        why = f"trials with a different number of segments, which do not count: {left_out}" if left_out else ""
        for kind, sets in (("base", counted), ("modified", [_modify(one) for one in counted])):
            for same in zip(*sets, strict=True):
                row: dict[str, Any] = {
                    "subject": subject,
                    "set": kind,
                    **{name: same[0][name] for name in ("parameter", "expression", "unit")},
                    "segments": segments,
                    "subjects": 1,
                    "trials": len(counted),
                    "why": why if len(counted) > 1 else "a single trial has no variation",
                }
                columns = {"": [one["value"] for one in same], "reference_": [one["reference"] for one in same]}
                for prefix, values in columns.items():
                    mean, sd = find_mean_sd(values)
                    cv = sd / abs(mean) if abs(mean) > _ROUNDING else math.nan
                    row |= {f"{prefix}mean": mean, f"{prefix}sd": sd, f"{prefix}cv": cv}
                rows.append(row)
    means = {name: (name, f"{name}_sd") for name in ("cv", "reference_cv")}
    keys = ("set", "parameter", "expression", "unit", "segments")
    return [*rows, *pool_people((row for row in rows if row["trials"] > 1), keys, means)]


def _modify(parameters: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the modified parameters, in which a length mr replaces each pair (mx, my).

    A segment's coordinate frame rotates slightly from trial to trial, which mixes mx and my. The modified parameters do
    not depend on this rotation. If both mx and my of a segment are known, they are replaced by

        mr = |(mx, my)|

    where mx and my include everything that is regrouped into them. The base segment has only mx, which does not change.
    """
    by_symbol = {one["parameter"]: one for one in parameters}
    modified: list[Mapping[str, Any]] = []
    for symbol, mx in by_symbol.items():
        my = by_symbol.get(symbol.replace("mx", "my")) if symbol.startswith("mx") else None
        if my is not None:
            lengths = {name: math.hypot(mx[name], my[name]) for name in ("value", "reference")}
            expression = f"|({mx['expression']}, {my['expression']})|"
            modified.append({**mx, "parameter": symbol.replace("mx", "mr"), "expression": expression, **lengths})
        elif not (symbol.startswith("my") and symbol.replace("my", "mx") in by_symbol):
            modified.append(mx)
    return modified


# The columns of all tables, and how the page shows them.

_SUBJECT = text("subject", "id of the person; `cohort` = all people", head="")
_STRATEGY = text("strategy", "strategy of the movement", lambda trial: trial.strategy, "strategy")
_SUBJECTS = whole("subjects", "number of people in the row")
_TRIALS = whole("trials", "number of trials in the row", head="trials")
_WHY = text("why", "why numbers are missing; empty otherwise", head="")
_PARAMETER = (
    text("parameter", "short name as in the thesis: m1, mx1, mr2, I2 …", head="parameter"),
    text("expression", "the parameters that are regrouped into this parameter", head="expression"),
    text("unit", "kg, kg*m or kg*m^2"),
)
_LENGTH_ERROR = "minus reference, relative to the reference"


def _reference(head: str) -> ResultColumn:
    meaning = "reference of the lengths: landmarks, or stature and allometric table"
    return text("reference", meaning, lambda trial: trial.reference, head, missing=UNKNOWN)


def _count_repetitions(trial: TrialResult, *, complete: bool = False) -> int | None:
    repetitions = trial.value("repetitions")
    return None if repetitions is None else sum(bool(one["complete"]) or not complete for one in repetitions)


def _length_columns(segment: str) -> list[ResultColumn]:
    """Return the columns of a segment's length, its standard deviation, its reference, and the difference."""
    return [
        number(segment, "m", f"length of the {segment}, {SEGMENTS[segment]}", lambda trial: trial.length(segment)),
        number(f"{segment}_sd", "m", "its standard deviation", read_entry("lengths_m", segment, "sd")),
        number(
            f"{segment}_reference",
            "m",
            f"reference length of the {segment}",
            lambda trial: trial.reference_lengths[segment],
        ),
        number(f"{segment}_error", "%", f"{segment} {_LENGTH_ERROR}", lambda trial: trial.length_error(segment)),
    ]


def _five_times_columns() -> Iterator[ResultColumn]:
    """Yield the columns of the five-times test, which its result declares."""

    def show_five_times(row: Mapping[str, Any]) -> str:
        seconds, sd = to_number(row["five_times"]), to_number(row["five_times_sd"])
        return show_fixed(seconds, 2) if seconds is None or sd is None else f"{seconds:.2f} ± {sd:.3f}"

    for name, quantity in list_quantities(FiveTimes):
        if quantity.column:
            value = read_entry("five_times", name)
            column = count(quantity.column, quantity.meaning, value)
            if quantity.unit:
                column = number(quantity.column, quantity.unit, quantity.meaning, value)
            if quantity.column == "five_times":
                column = shown_as(column, "five times (s)", show_five_times, optional=True)
            yield column
        if quantity.column and quantity.sd and quantity.column_sd:
            sd = read_entry("five_times", quantity.sd)
            yield number(f"{quantity.column}_sd", quantity.unit, "its standard deviation", sd)


def _model_errors(model: str, meaning: str, head: str) -> Iterator[ResultColumn]:
    """Yield the columns of a model's errors; a page shows the root mean square of the centre of pressure."""
    names = {OWN: "own", HELD_OUT: "held_out"}

    def read_part(name: str, part: int) -> Callable[[TrialResult], float | None]:
        def read(trial: TrialResult) -> float | None:
            bodies = [body for body in trial.bodies if names.get(body.name, "reference") == model]
            error = next((body.errors[name] for body in bodies if body.errors.get(name) is not None), None)
            return None if error is None else (error.bias, error.sd, math.hypot(error.bias, error.sd))[part]

        return read

    for name, unit in SERIES.items():
        for part, column in enumerate(error_columns(f"{name}_{model}", unit, meaning)):
            shown = millimetres(head, column.name, optional=True) if column.name == f"cop_x_{model}_rms" else None
            yield replace(column, value=read_part(name, part), shown=shown)


def _variation(name: str, meaning: str, head: str) -> ResultColumn:
    def cell(row: Mapping[str, Any]) -> str:
        mean, sd = scale(row[name], 100), scale(row[f"{name}_sd"], 100)
        return show(mean, 2) if sd is None else f"{show(mean, 2)} ± {show(sd, 2)}"

    return shown_as(number(name, "1", meaning), head, cell)


TABLES = declare_tables(
    trials=(
        *TRIAL_COLUMNS,
        _STRATEGY,
        *VERDICT_COLUMNS,
        *(SUMMARY_COLUMNS[name] for name in ("segments", "confidence")),
        *(column for segment in SEGMENTS for column in _length_columns(segment)[:2]),
        _reference("reference"),
        *(_length_columns(segment)[2] for segment in SEGMENTS),
        *(_length_columns(segment)[3] for segment in SEGMENTS),
        *(SUMMARY_COLUMNS[name] for name in ("reprojection", "missing_fraction", "mass")),
        count("samples", "number of samples of the fit", read_entry("dynamics", "samples")),
        *(SUMMARY_COLUMNS[name] for name in ("condition_number", "clock_offset")),
        shown_as(
            count("repetitions", "number of repetitions found", _count_repetitions),
            "complete repetitions",
            lambda row: (
                UNKNOWN if to_number(row["repetitions"]) is None else f"{row['complete']} of {row['repetitions']}"
            ),
            optional=True,
        ),
        count(
            "complete", "number of repetitions with all their events", lambda t: _count_repetitions(t, complete=True)
        ),
        *_five_times_columns(),
        *_model_errors("own", "own model minus measurement over the samples of the fit", "CoP, own (mm)"),
        *_model_errors("held_out", "own model on left-out repetitions minus measurement", "held out (mm)"),
        *_model_errors("reference", "allometric body minus measurement, same samples", "allometric (mm)"),
    ),
    lengths=(
        _SUBJECT,
        text("segment", "shank (knee to ankle) or thigh (hip to knee)", head="segment"),
        _reference("against"),
        text(
            "method",
            "framework = this program; stature = height times the factor in the allometric table",
            head="method",
        ),
        _SUBJECTS,
        shown_as(
            _TRIALS,
            "people, or trials",
            lambda row: str(row["subjects"] if row["subject"] == COHORT else row["trials"] or UNKNOWN),
        ),
        number("length_mean", "m", "length by this method, mean", head="length (cm)", decimals=2, factor=100),
        number("length_sd", "m", "its standard deviation over the trials, for the cohort over the people"),
        number("reference_length", "m", "reference length, mean", head="reference (cm)", decimals=2, factor=100),
        *error_columns(
            "error",
            "%",
            f"method {_LENGTH_ERROR}; over trials, for the cohort over people",
            "mean sd",
            head="difference (%)",
        ),
        _WHY,
    ),
    strategies=(
        _SUBJECT,
        _STRATEGY,
        _reference("lengths against"),
        _SUBJECTS,
        _TRIALS,
        *error_columns("shank_error", "%", f"shank {_LENGTH_ERROR}", "mean sd", head="shank (%)"),
        *error_columns("thigh_error", "%", f"thigh {_LENGTH_ERROR}", "mean sd", head="thigh (%)"),
        *error_columns(
            "reprojection",
            "m",
            SUMMARY_COLUMNS["reprojection"].meaning,
            "mean sd",
            head="re-projection (mm)",
            factor=1e3,
        ),
        *error_columns(
            "condition_number", "1", SUMMARY_COLUMNS["condition_number"].meaning, "mean sd", head="condition number"
        ),
    ),
    models=(
        _SUBJECT,
        text(
            "action",
            "strategy of the predicted trial",
            head="action",
            cell=lambda row: row["action_trial"] or row["action"],
        ),
        text(
            "model",
            "own; own, held out (on left-out repetitions); a strategy (the body of another trial of the same "
            "person with this strategy); or the allometric table",
            head="model",
            cell=lambda row: row["model"] if row["model"].startswith("own") else row["model_trial"] or row["model"],
        ),
        text("action_trial", "the predicted trial; empty for the cohort", head="action"),
        text(
            "model_trial",
            "the trial of the body; empty for the cohort and the allometric table",
            head="model",
            cell=lambda row: row["model_trial"] or row["model"],
        ),
        _SUBJECTS,
        whole("pairs", "number of predictions in the row; each has the same weight", head="predictions"),
        count("samples", "number of compared samples, without contact to the seat"),
        *error_columns(
            "condition_number",
            "1",
            "condition number of the chain's regressor of the predicted trial",
            "mean sd",
            head="condition number",
            decimals=0,
        ),
        *(
            column
            for name, unit in SERIES.items()
            for column in error_columns(
                name,
                unit,
                "model minus measurement",
                head={"Fy": "Fy (N)", "tauz": "τz (N·m)", "cop_x": "CoP (mm)"}.get(name),
                factor=1e3 if name == "cop_x" else 1.0,
            )
        ),
        number("registration_residual", "m", "distance between the markers of the two trials after registration, rms"),
        text("supported", "yes or no: whether the recordings support this transfer; empty if unknown"),
        text("codes", "codes of the reasons not to rely on the prediction"),
        _WHY,
        *error_columns("tau_{k}", "N*m", "joint torque minus the torque of the predicted trial's own model", "mean sd"),
    ),
    parameters=(
        *TRIAL_COLUMNS,
        _STRATEGY,
        *_PARAMETER,
        number("value", "", "identified value, in `unit`"),
        number("sd", "", "its standard deviation, in `unit`"),
        text("verdict", "known, weak or not identifiable"),
        number("reference", "", "value for the allometric body on the same chain, in `unit`"),
    ),
    variation=(
        _SUBJECT,
        text("set", "base, or modified: each (mx, my) replaced by its length mr", head="set"),
        *_PARAMETER,
        whole("segments", "number of segments of the chains with the base"),
        _SUBJECTS,
        _TRIALS,
        number("mean", "", "mean of the identified values over the trials, in `unit`"),
        number("sd", "", "their standard deviation, in `unit`"),
        _variation(
            "cv",
            "coefficient of variation, sd divided by the absolute mean; for the cohort its mean",
            "own models (%)",
        ),
        number("cv_sd", "1", "for the cohort: its standard deviation over the people"),
        number("reference_mean", "", "mean for the allometric body on the same chains, in `unit`"),
        number("reference_sd", "", "standard deviation for the allometric body, in `unit`"),
        _variation("reference_cv", "coefficient of variation for the allometric body", "allometric body (%)"),
        number("reference_cv_sd", "1", "for the cohort: its standard deviation over the people"),
        _WHY,
    ),
)
STUDY = StudyKind(
    labels=("strategy",),
    read=_read_result,
    tables=TABLES,
    rows={
        "lengths": length_rows,
        "strategies": strategy_rows,
        "models": model_rows,
        "parameters": parameter_rows,
        "variation": variation_rows,
    },
    page=lambda data, _: render_cohort_page(data),
)
