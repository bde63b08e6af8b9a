"""``mocap-id validate robot``: the robot study of the thesis (ch. 5), trials of one joint each with every method.

From top to bottom: the truth of a simulated trial; the methods for the joint states; the result of a trial with each
method; the table `trials`; the thesis's tables 5.1 to 5.6; the data of the figures; the study.

The cameras determine the plane up to a rotation about the vertical, and the coordinate frame of the last segment up to
a constant angle. Parameters and series are therefore expressed in the robot's own frame if the encoder or the truth
determines it. In this frame, the angle is zero with the arm stretched upwards, and positive in the encoder's direction.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
import pandas as pd

from mocap_id import __version__, recording, runner
from mocap_id.arrays import FloatArray
from mocap_id.config import Trial
from mocap_id.config.study import RobotStudy, RobotTrial, load_robot_study
from mocap_id.dynamics.preparation import SampledWrench
from mocap_id.errors import ConfigError, MocapIdError, RecordingError
from mocap_id.reporting.grids import UNKNOWN, show_fixed, to_number
from mocap_id.reporting.results import (
    CommandResult,
    ResultColumn,
    ResultTable,
    declare_tables,
    error_columns,
    number,
    shown_as,
    text,
    whole,
)
from mocap_id.reporting.study import CohortData
from mocap_id.reporting.study.robots import (
    AveragedWrench,
    Recovery,
    RobotStudyData,
    StateTraces,
    draw_robot_figures,
    render_markdown,
    render_robot_page,
)
from mocap_id.reporting.style import format_unit
from mocap_id.stages import STAGES
from mocap_id.stages.trial_keys import get_recording
from mocap_id.store import Folder
from mocap_id.store.atomic import converting_errors, write_files
from mocap_id.store.folder import check_owner, record_file, store_owner
from mocap_id.workflows.identified_trial import IdentifiedTrial, open_identified_trial
from mocap_id.workflows.parallel import LocalBackend, TrialCallback, TrialRun, run_trial, run_trials
from mocap_id.workflows.run_folder import find_owner_of_files
from mocap_id.workflows.study.study import group_by
from mocap_id.workflows.trial_outcome import TrialOutcome, number_or_nan, read_summary

PAGE, DOCUMENT, MARKDOWN = "robot.html", "validation.json", "robot.md"
STATES = {"theta": "rad", "dtheta": "rad/s", "ddtheta": "rad/s^2"}
WRENCH = {"Fx": "N", "Fy": "N", "tauz": "N*m"}
PARAMETERS = {"mass": "kg", "mx1": "kg*m", "mx2": "kg*m", "my2": "kg*m", "Izz2": "kg*m^2"}
"""Units of the base parameters of one joint, by name."""
_STATES_STAGE, _DYNAMICS_STAGE = "ukf-smooth", "identify-dim"
_FAST = 0.375  # Hz: the mean of the thesis's two speeds


# The truth of a simulated trial.


@dataclass(frozen=True)
class Truth:
    """The exact states and the encoder's clock of a simulated trial."""

    document: Mapping[str, Any]  # content of truth.json
    time: FloatArray  # (T,) times of the frames on the recording's clock, s
    states: FloatArray  # (T, 3) angle, velocity and acceleration of the joint, rad, rad/s, rad/s²

    @classmethod
    def read(cls, motion: Path) -> Truth | None:
        """Read truth.json and truth.npz beside a recording; None if one of them is missing."""
        file, arrays = motion.parent / "truth.json", motion.parent / "truth.npz"
        if not (file.exists() and arrays.exists()):
            return None
        try:
            document = json.loads(file.read_text("utf-8"))
            with np.load(arrays) as data:
                states = np.column_stack([data[name][:, 0] for name in ("q", "qd", "qdd")]).astype(np.float64)
                return cls(document, np.asarray(data["t"], dtype=np.float64), states)
        except (OSError, ValueError, KeyError, IndexError) as error:
            why = f"the file is not the truth of a simulated trial ({error}); remove it"
            raise RecordingError(f"{file}: {why}") from None

    def at(self, time: FloatArray) -> FloatArray:
        """Return the states (N, 3) at times (N,) of frames, s; NaN for a time without a frame."""
        step = float(np.median(np.diff(self.time)))
        nearest = np.clip(np.searchsorted(self.time, time - 0.5 * step), 0, len(self.time) - 1)
        known = np.abs(self.time[nearest] - time) < 0.5 * step
        return np.where(known[:, None], self.states[nearest], np.nan)


# The methods for the joint states; stages that do not depend on the method run once.


CAMERAS, ENCODER, DIFFERENCES = "cameras", "encoder", "differences"
METHODS: Mapping[str, Mapping[str, str | float]] = {
    CAMERAS: {},
    ENCODER: {"method": "encoder"},
    DIFFERENCES: {"method": "butterworth", "butterworth_hz": 20.0},
    "differences-6": {"method": "butterworth", "butterworth_hz": 6.0},
    "spline": {"method": "spline"},
}
"""Settings of `ukf-smooth` of each method that replace the settings of the trial."""
REFERENCE = "reference"
"""Value of `method` in the rows of the reference parameters."""


def _apply_methods(trial: Trial) -> Iterator[tuple[str, Trial]]:
    """Yield the trial with each method; all methods but the first have a run folder in the trial's folder."""
    yield CAMERAS, trial
    for method, settings in METHODS.items():
        if method != CAMERAS and (method != ENCODER or trial.keys.encoder is not None):
            changed = trial.settings[_STATES_STAGE].model_copy(update=dict(settings))
            out = trial.out / "methods" / method
            yield method, replace(trial, settings={**trial.settings, _STATES_STAGE: changed}, out=out)


def run_all_methods(trial: Trial) -> TrialRun:
    """Run a trial with its report, then its dynamics with every other method; a failure is returned as a result.

    The encoder's method is omitted if the trial has no encoder. The first method that fails ends the run.
    """
    done = run_trial(trial)
    if done.exit_code != 0:
        return done
    before = STAGES[: next(k for k, stage in enumerate(STAGES) if stage.name == _STATES_STAGE)]
    shared = [file for stage in before for file in (*stage.outputs, record_file(stage.name))]
    for method, variant in list(_apply_methods(trial))[1:]:
        try:
            # Link or copy the artefacts of the stages before the joint states into the run folder of the method.
            with converting_errors(variant.out):
                for file in shared:
                    source, copy = trial.out / file, variant.out / file
                    copy.parent.mkdir(parents=True, exist_ok=True)
                    if copy.exists() and copy.samefile(source):
                        continue
                    copy.unlink(missing_ok=True)
                    try:
                        os.link(source, copy)
                    except OSError:
                        shutil.copy2(source, copy)
            outcome = runner.run_to(variant, _DYNAMICS_STAGE)
            if outcome.refused is not None:
                raise outcome.refused
        except MocapIdError as error:
            message = f"with the method {method}: {error}"
            return replace(
                done, exit_code=error.exit_code, message=message, published=message.replace(str(trial.out), trial.name)
            )
        done = replace(
            done,
            computed=done.computed or any(step.action == "computed" for step in outcome.steps),
            seconds=done.seconds + sum(step.seconds or 0.0 for step in outcome.steps),
        )
    return done


# The result of one trial with each method.


@dataclass(frozen=True)
class MethodResult:
    """The result of one trial with one method."""

    folder: Folder
    identified: IdentifiedTrial
    # the robot's coordinate frame in the plane: angle in the plane = sign * robot's angle + zero, rad
    sign: int
    zero: float
    time: FloatArray  # (T,) times of the samples, s
    states: FloatArray  # (T, 3) angle, velocity and acceleration in the plane, rad, rad/s and rad/s²
    row: dict[str, Any]  # its columns of the table `trials`


def _to_robot(sign: int, zero: float) -> FloatArray:
    """Return the matrix (5, 5) that transforms base parameters from the plane to the robot's frame."""
    c, s = np.cos(zero), np.sin(zero)
    matrix = np.diag([1.0, sign, 1.0, 1.0, 1.0])
    matrix[2:4, 2:4] = [[sign * c, -sign * s], [s, c]]
    return matrix


def compare_with(name: str, difference: FloatArray, reference: FloatArray) -> dict[str, float]:
    """Return bias, standard deviation and r² of a series as columns; NaN samples do not count.

    ``difference`` (N,) is the series minus its ``reference`` (N,). Without two known samples, there are no columns.
    """
    both = np.isfinite(difference) & np.isfinite(reference)
    if np.count_nonzero(both) < 2:
        return {}
    difference, spread = difference[both], float(np.var(reference[both]))
    r2 = 1.0 - float(np.mean(difference**2)) / spread if spread > 0 else np.nan
    return {f"{name}_bias": float(np.mean(difference)), f"{name}_sd": float(np.std(difference)), f"{name}_r2": r2}


def _read_method_result(folder: Folder, truth: Truth | None, *, by_encoder: bool) -> MethodResult:
    """Read a trial's result; states that are ``by_encoder`` are not compared with the encoder."""
    identified = open_identified_trial(folder.path)
    facts, encoder = identified.facts, folder.table("encoder.parquet")
    # The robot's frame from its encoder, or else from the truth, or else the frame of the plane.
    sign, zero = 1, 0.0
    if encoder.facts.get("sign") is not None:
        sign, zero = int(encoder.facts["sign"]), float(encoder.facts["zero_rad"])
    elif truth is not None:
        table = folder.table("states.parquet")
        angle, true = table["theta_1"], truth.at(table["time"])[:, 0]
        both = np.isfinite(angle) & np.isfinite(true)
        sign = 1 if np.cov(angle[both], true[both])[0, 1] >= 0 else -1
        zero = float(np.mean(angle[both] - sign * true[both]))
    time = identified.dynamics["time"].to_numpy(dtype=np.float64)
    states = np.column_stack([identified.q[:, 0], identified.dq[:, 0], identified.ddq[:, 0]])
    row: dict[str, Any] = {
        "against": "",
        "condition": number_or_nan(facts.get("condition_number")),
        "clock_offset": number_or_nan(facts.get("clock_offset_s")),
        "encoder_offset": encoder.facts.get("clock_offset_s"),
        "encoder_offset_sd": encoder.facts.get("clock_offset_sd_s"),
    }
    # Base parameters in the robot's frame.
    tree, count = folder.tree("dynamics.h5"), len(PARAMETERS)
    value, covariance = tree.numbers("base/value"), tree.array("base/covariance").astype(np.float64)
    verdicts = tree.texts("base/verdict")
    if len(value) == count:
        matrix = _to_robot(sign, zero)
        value, covariance = matrix @ value, matrix @ covariance @ matrix.T
    else:
        value, covariance = np.full(count, np.nan), np.full((count, count), np.nan)
        verdicts = ("not identifiable",) * count
    for name, one, sd, verdict in zip(PARAMETERS, value, np.sqrt(np.diagonal(covariance)), verdicts, strict=True):
        row |= {name: one, f"{name}_sd": sd, f"{name}_verdict": verdict}
    # States against the truth or the encoder. The mean error of the angle is removed, because the zero of the angle
    # depends on the coordinate frame.
    reference: FloatArray | None = None
    if truth is not None:
        reference, row["against"] = sign * truth.at(time), "truth"
    elif encoder.length and not by_encoder:
        reference, row["against"] = encoder.stack(tuple(STATES)), "encoder"
    if reference is not None:
        errors = states - reference
        known = np.isfinite(errors[:, 0])
        errors[:, 0] -= np.mean(errors[known, 0]) if known.any() else 0.0
        for d, name in enumerate(STATES):
            row |= compare_with(name, errors[:, d], reference[:, d])
    # Wrench and torque of the model minus the measurement over the samples of the fit.
    fits = {**dict.fromkeys(WRENCH), **(facts.get("wrench") or {}), "torque": facts.get("torque")}
    for name in (*WRENCH, "torque"):
        row |= {f"{name}_{part}": number_or_nan((fits[name] or {}).get(part)) for part in ("bias", "sd", "r2")}
    # Distances of the moving markers from their prediction.
    markers, skeleton = folder.long("markers.parquet"), identified.skeleton
    moving = [name for name, segment in zip(skeleton.markers, skeleton.segment, strict=True) if segment > 0]
    residual = markers.values["residual"]
    own = np.isin(markers.labels, moving) & markers.values["used"].astype(np.bool_)
    distances = residual[own & np.isfinite(residual)]
    if len(distances):
        row |= {"marker_bias": float(np.mean(distances)), "marker_sd": float(np.std(distances))}
    return MethodResult(folder, identified, sign, zero, time, states, row)


@dataclass(frozen=True, kw_only=True)
class RobotTrialResult(TrialOutcome):
    """The result of one robot trial with every method."""

    trial: RobotTrial
    joint: str  # joint, speed and orientation identify a cell of the thesis's tables; empty or None if unknown
    speed: str
    orientation: float | None
    truth: Truth | None
    reference: Mapping[str, float]  # known reference parameters, and ``base``: distance of the joint from the origin, m
    by_method: Mapping[str, MethodResult]  # empty for a trial that failed or was refused

    @property
    def name(self) -> str:
        return self.trial.trial.name

    @property
    def cell(self) -> tuple[str, str]:
        """Joint and speed, which identify a cell in the thesis's tables."""
        return self.joint, self.speed

    @property
    def method_of_reference(self) -> MethodResult | None:
        """The result whose states are used with the reference parameters; None if a reference parameter is unknown."""
        known = all(name in self.reference for name in PARAMETERS)
        return self.by_method.get(ENCODER, self.by_method.get(CAMERAS)) if known else None


def _read_result(study: RobotStudy, trial: RobotTrial, run: TrialRun) -> RobotTrialResult:
    config = trial.trial
    truth = Truth.read(get_recording(config.keys).motion)
    document = {} if truth is None else truth.document
    frequency, yaw = document.get("freq_hz"), document.get("robot_yaw_deg")
    true_speed = "" if frequency is None else "fast" if frequency > _FAST else "slow"
    joint = trial.joint or str(document.get("joint") or "")
    reference: dict[str, float] = {}
    if joint in study.reference:
        reference = study.reference[joint].model_dump(exclude_none=True)
    elif truth is not None:
        reference = dict(zip(PARAMETERS, map(float, document["base_parameters"]["values"]), strict=True))
        lengths = document.get("segment_lengths_m", {})
        reference |= {"base": float(lengths["l1"])} if "l1" in lengths else {}
    return RobotTrialResult(
        trial=trial,
        run=run,
        summary=read_summary(config.out, run),
        joint=joint,
        speed=trial.speed or true_speed,
        orientation=float(yaw) if trial.orientation is None and yaw is not None else trial.orientation,
        truth=truth,
        reference=reference,
        by_method={
            method: _read_method_result(Folder(variant.out), truth, by_encoder=method == ENCODER)
            for method, variant in (_apply_methods(config) if run.exit_code == 0 else ())
        },
    )


def predict_reference(trial: RobotTrialResult, result: MethodResult) -> tuple[FloatArray, FloatArray]:
    """Return wrench (T, 3) and torque (T,) in the plane, from the reference parameters and the states of a method."""
    identified = result.identified
    base = np.linalg.solve(
        _to_robot(result.sign, result.zero), np.array([trial.reference[name] for name in PARAMETERS])
    )
    full = np.linalg.pinv(result.folder.tree("dynamics.h5").array("base/regrouping").astype(np.float64)) @ base
    return identified.chain.regressor @ full, (identified.chain.torque_regressor @ full)[:, 0]


# The table `trials`: a row for each trial and method, and a row for each trial with the reference parameters.


def trial_rows(trials: Sequence[RobotTrialResult]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table; a trial without results has a single row without numbers."""
    for trial in trials:
        labels = {
            "trial": trial.name,
            "joint": trial.joint,
            "speed": trial.speed,
            "orientation": np.nan if trial.orientation is None else trial.orientation,
            "verdict": trial.level,
            "codes": ", ".join(trial.codes),
        }
        if not trial.by_method:
            yield labels | {"method": CAMERAS}
        base, sd = (trial.value("lengths_m", "base", key) for key in ("value", "sd"))
        truth = {} if trial.truth is None else trial.truth.document.get("encoder", {})
        shared = {
            "base": base,
            "base_sd": sd,
            "base_error": None if base is None else base - trial.reference.get("base", np.nan),
            "encoder_offset_truth": truth.get("clock_offset_s"),
            **{f"{name}_reference": trial.reference.get(name) for name in PARAMETERS},
        }
        for name, result in trial.by_method.items():
            yield labels | {"method": name} | shared | result.row
        through = trial.method_of_reference
        if through is None:
            continue
        # The reference parameters, and the errors of the wrench and torque that they predict for the states.
        wrench, torque = predict_reference(trial, through)
        row: dict[str, Any] = {name: trial.reference[name] for name in PARAMETERS}
        row |= {f"{name}_reference": trial.reference[name] for name in PARAMETERS}
        dynamics = through.identified.dynamics
        fitted = dynamics["in_fit"].to_numpy(dtype=np.bool_)
        for k, name in enumerate(WRENCH):
            measured = dynamics[name].to_numpy(dtype=np.float64)[fitted]
            row |= compare_with(name, wrench[fitted, k] - measured, measured)
        # The torque is compared with the torque in the encoder's file, at its times.
        file, encoder = trial.trial.trial.keys.encoder, through.folder.read("encoder.parquet").facts
        log = None if file is None else recording.read_encoder(file)
        if log is not None and log.torque is not None and encoder.get("sign") is not None:
            measured = encoder["sign"] * log.torque
            model = SampledWrench(through.time, torque[:, None])(log.time + encoder["clock_offset_s"])[:, 0]
            row |= compare_with("torque", model - measured, measured)
        yield labels | {"method": REFERENCE} | row


_SOURCES = {"this": "this program", "thesis": "thesis"}
_CELL = (
    text("joint", "the joint that moves", head="joint", missing=UNKNOWN),
    text("speed", "speed of the movement", head="speed", missing=UNKNOWN),
    shown_as(
        number("orientation", "deg", "angle of the robot about the vertical; NaN: all orientations"),
        "orientation (deg)",
        lambda row: show_fixed(row["orientation"], 0),
        optional=True,
        text=True,
    ),
    text(
        "obs",
        "P: states from the cameras; R: from the encoder; Ref.: reference parameters; else name of a method",
        head="obs.",
    ),
    text("source", "`this` program, or the `thesis`", head="by", cell=lambda row: _SOURCES[row["source"]]),
    shown_as(
        whole("trials", "number of trials in the row; 0 for the thesis"),
        "trials",
        lambda row: str(row["trials"] or UNKNOWN),
        text=True,
    ),
)
"""Columns that identify the cell of the thesis's tables to which a row belongs."""


def _series_columns(units: Mapping[str, str], meaning: str) -> list[ResultColumn]:
    """Return bias, standard deviation and r² of each series; ``{}`` in the meaning stands for the name."""
    return [
        number(f"{name}_{part}", "1" if part == "r2" else unit, f"{meaning.format(name)}: {words}")
        for name, unit in units.items()
        for part, words in (("bias", "mean"), ("sd", "standard deviation"), ("r2", "r²"))
    ]


TRIALS = declare_tables(
    trials=(
        text("trial", "name of the trial and of its run folder", head="trial"),
        *_CELL[:3],
        text("method", "cameras, encoder, differences, differences-6, spline, or reference"),
        text("verdict", "verdict of the trial: ok, caution, refused or failed", head="verdict"),
        text("codes", "codes of the verdict's reasons", head="reasons", missing=UNKNOWN),
        text("against", "reference of the states: truth or encoder; empty without a reference"),
        number("base", "m", "distance of the joint from the plane's origin", head="l₁ (mm)", decimals=2, factor=1e3),
        number("base_sd", "m", "its standard deviation"),
        number(
            "base_error",
            "m",
            "distance minus the distance of the reference",
            head="error of l₁ (mm)",
            decimals=2,
            factor=1e3,
        ),
        *_series_columns({"marker": "m"}, "distance of the moving markers from their prediction")[:2],
        *_series_columns(STATES, "{} minus the value of the truth or the encoder"),
        number("condition", "1", "condition number of the stacked regressor", head="condition"),
        *(
            column
            for name, unit in PARAMETERS.items()
            for column in (
                number(name, unit, f"base parameter {name} in the robot's own frame"),
                number(f"{name}_sd", unit, "its standard deviation"),
                number(f"{name}_reference", unit, "value of the reference"),
                text(f"{name}_verdict", "known, weak or not identifiable"),
            )
        ),
        *_series_columns({"torque": "N*m"}, "torque of the model minus the encoder's"),
        *_series_columns(WRENCH, "{} of the model minus the measured"),
        number("clock_offset", "s", "clock offset, plates after cameras"),
        number(
            "encoder_offset",
            "s",
            "offset of the encoder's clock: its sample at t is the state at t + this offset",
            head="clock of the encoder (ms)",
            decimals=3,
            factor=1e3,
        ),
        number("encoder_offset_sd", "s", "its standard deviation"),
        number("encoder_offset_truth", "s", "true offset, if known"),
    )
)["trials"]


# The thesis's tables 5.1 to 5.6: each cell averaged over the trials, followed by the values in the thesis.


_ORDER = ("shoulder", "elbow", "wrist"), ("slow", "fast")
_UNITS = {"m": ("mm", 1e3), "rad": ("deg", 180 / np.pi), "rad/s": ("deg/s", 180 / np.pi)}
_DECIMALS = {"mm": 2, "deg": 3, "deg/s": 2, "1": 1, "kg·m²": 4}
_SYMBOLS = {
    "mass": "m₁+m₂", "mx1": "mx₁+Tₓm₂", "mx2": "mx₂", "my2": "my₂", "Izz2": "Izz₂",
    "theta": "ε_θ", "dtheta": "ε_θ̇", "ddtheta": "ε_θ̈", "Fx": "ε_Fx", "Fy": "ε_Fy", "tauz": "ε_τz",
}  # fmt: skip


@dataclass(frozen=True)
class ThesisQuantity:
    """A quantity in a table of the thesis, with a column for its mean and one for its standard deviation."""

    name: str
    unit: str
    meaning: str
    symbol: str  # heading of the column
    # For a value, the columns are mean and standard deviation over the trials. For an error, they are the mean of the
    # trials' biases and the root mean square of the trials' standard deviations.
    kind: Literal["value", "error"] = "value"
    to_si: float = 1.0  # factor from the thesis's unit to SI
    decimals: int | None = None  # number of decimals; None for the usual number of the unit

    @property
    def columns(self) -> list[ResultColumn]:
        """The columns; a page shows them in one cell, ``mean (standard deviation)``."""
        shown, factor = _UNITS.get(self.unit, (format_unit(self.unit), 1.0))
        decimals = _DECIMALS.get(shown, 3) if self.decimals is None else self.decimals

        def cell(row: Mapping[str, Any]) -> str:
            mean, sd = to_number(row[f"{self.name}_mean"]), to_number(row[f"{self.name}_sd"])
            if mean is None and sd is None:
                return UNKNOWN
            value = "?" if mean is None else show_fixed(factor * mean, decimals)
            return value if sd is None else f"{value} ({show_fixed(factor * sd, decimals)})"

        mean, sd = error_columns(self.name, self.unit, self.meaning, "mean sd")
        return [shown_as(mean, self.symbol if self.unit == "1" else f"{self.symbol} ({shown})", cell), sd]


def _add_r2(name: str, unit: str, meaning: str, symbol: str) -> tuple[ThesisQuantity, ThesisQuantity]:
    return (
        ThesisQuantity(name, unit, meaning, symbol, "error"),
        ThesisQuantity(f"{name}_r2", "1", f"{meaning}: r²", f"{symbol} r²", decimals=5),
    )


_DYNAMICS = (
    ThesisQuantity("condition", "1", "condition number of the stacked regressor", "condition"),
    *(ThesisQuantity(name, unit, f"base parameter {name}", _SYMBOLS[name]) for name, unit in PARAMETERS.items()),
    *_add_r2("torque", "N*m", "torque of the model minus the encoder's", "ε_τ"),
)
_MEASURED = {"encoder": "R", "cameras": "P"}
_ALL = {"reference": "Ref.", **_MEASURED}
_DEG = np.pi / 180

_Table: TypeAlias = tuple[str, Mapping[str, str], tuple[ThesisQuantity, ...]]
TABLES: Mapping[str, _Table] = {
    "table_5_1": (
        "Kinematic parameters and errors (thesis table 5.1)",
        {"cameras": "P"},
        (
            ThesisQuantity("base", "m", "distance of the joint from the plane's origin", "l₁", to_si=1e-3),
            ThesisQuantity("marker", "m", "distance of the markers from their prediction", "ε_M", "error", 1e-3),
            ThesisQuantity("theta", "rad", "angle minus the true or the encoder's angle", "ε_θ", "error", _DEG),
            ThesisQuantity(
                "dtheta", "rad/s", "velocity minus the true or the encoder's velocity", "ε_θ̇", "error", _DEG
            ),
            ThesisQuantity("base_error", "m", "distance minus the distance of the reference", "l₁ − reference"),
        ),
    ),
    "table_5_2": ("Dynamic parameters (thesis table 5.2)", _ALL, _DYNAMICS),
    "table_5_3": (
        "Joint states against the truth or the encoder (thesis table 5.3)",
        _MEASURED,
        tuple(
            quantity
            for name, unit in STATES.items()
            for quantity in _add_r2(name, unit, f"{name} minus the truth's", _SYMBOLS[name])
        ),
    ),
    "table_5_4": (
        "Contact wrench of the models minus the measured one (thesis table 5.4)",
        _ALL,
        tuple(
            quantity
            for name, unit in WRENCH.items()
            for quantity in _add_r2(name, unit, f"{name} of the model minus the measured", _SYMBOLS[name])
        ),
    ),
    "table_5_5_6": (
        "Dynamic parameters by every method for the states (thesis tables 5.5 and 5.6)",
        {"cameras": "UKF", "differences": "Diff.", "differences-6": "Diff. 6 Hz", "spline": "Spline"},
        (
            *_DYNAMICS,
            ThesisQuantity(
                "ddtheta_r2", "1", "r² of the acceleration against the truth or the encoder", "ε_θ̈ r²", decimals=5
            ),
        ),
    ),
}
"""Title, labels of the methods in the thesis, and quantities, first those in the thesis in its order, of each table."""
_BY_ORIENTATION = "table_5_1"  # each orientation has a row of its own
_SCHEMAS = {
    "trials": TRIALS,
    **declare_tables(
        **{
            name: (*_CELL, *(column for each in quantities for column in each.columns))
            for name, (_, _, quantities) in TABLES.items()
        }
    ),
}


def cell_rows(table: str, trials: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows of a table: a row for each cell with trials, followed by the thesis's row for this cell.

    ``trials`` are the rows of the table `trials`.
    """
    _, methods, quantities = TABLES[table]
    in_thesis = read_published(table)
    keys = ("joint", "speed", "orientation") if table == _BY_ORIENTATION else ("joint", "speed")
    passed = [row for row in trials if row["method"] in methods and row["verdict"] != "failed"]
    groups = group_by(passed, lambda row: tuple(row[key] for key in keys))

    def rank(key: tuple[Any, ...]) -> tuple[Any, ...]:
        known = [order.index(name) if name in order else len(order) for order, name in zip(_ORDER, key, strict=False)]
        return (*known, *(str(part) for part in key))

    rows: list[dict[str, Any]] = []
    for key in sorted(groups, key=rank):
        cell = dict(zip(keys, key, strict=True))
        for method, obs in methods.items():
            own = [row for row in groups[key] if row["method"] == method]
            if not own:
                continue
            label = {"orientation": np.nan} | cell | {"obs": obs}
            averages = (value for one in quantities for value in _average(one, method, own).items())
            rows.append(label | {"source": "this", "trials": len(own)} | dict(averages))
            published = in_thesis.get((cell["joint"], cell["speed"], cell.get("orientation"), obs))
            if published is not None:
                rows.append(label | {"source": "thesis", "trials": 0} | published)
    return rows


def _average(one: ThesisQuantity, method: str, own: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return mean and standard deviation of a quantity over the trials of a cell with one method."""

    def read_known(column: str) -> FloatArray:
        values = np.array([row.get(column) for row in own], dtype=np.float64)
        return np.asarray(values[np.isfinite(values)])

    if one.kind == "value":
        centre = read_known(one.name)
        # A reference parameter is given, not estimated, so it has no standard deviation.
        is_given = method == REFERENCE and not one.name.endswith("_r2")
        sd = float(np.std(centre, ddof=1)) if len(centre) > 1 and not is_given else np.nan
    else:
        centre, sds = read_known(f"{one.name}_bias"), read_known(f"{one.name}_sd")
        sd = float(np.sqrt(np.mean(sds**2))) if len(sds) else np.nan
    return {f"{one.name}_mean": float(np.mean(centre)) if len(centre) else np.nan, f"{one.name}_sd": sd}


def read_published(table: str) -> Mapping[tuple[str, str, float | None, str], dict[str, float]]:
    """Return the values in the thesis, SI, by joint, speed, orientation (degrees; None if unknown), and method.

    They come from ``thesis_tables.csv``, in the units of the thesis; mean and standard deviation alternate. A value is
    empty if the thesis does not give it, or if it is illegible in our copy.
    """
    content = files("mocap_id.workflows.study").joinpath("thesis_tables.csv").read_text("utf-8")
    _, *lines = csv.reader(content.splitlines())
    rows = {}
    for name, joint, speed, orientation, obs, *cells in lines:
        if name == table:
            numbers = [float(cell or "nan") for cell in cells]
            row: dict[str, float] = {}
            # The thesis has fewer quantities.
            for one, mean, sd in zip(TABLES[table][2], numbers[::2], numbers[1::2], strict=False):
                row |= {f"{one.name}_mean": one.to_si * mean, f"{one.name}_sd": one.to_si * sd}
            rows[joint, speed, float(orientation) if orientation else None, obs] = row
    return rows


# The data of the figures: the recovery of one joint, and wrenches averaged over repetitions.

_PHASE = np.linspace(0.0, 100.0, 51)  # % of a repetition
_FRAMES = 60  # number of drawn frames of a marker's path
_FULL = 0.05  # largest difference of a repetition's extreme angles from the usual ones, divided by the usual range


def _collect_traces(trial: RobotTrialResult) -> StateTraces:
    """Return the joint states over time from the UKF and from differences, in the robot's coordinate frame."""
    first = trial.by_method[CAMERAS]
    zero = np.array([first.zero, 0.0, 0.0])
    curves = {
        label: first.sign * (trial.by_method[method].states - zero)
        for method, label in ((CAMERAS, "P"), (DIFFERENCES, "Diff."))
        if method in trial.by_method
    }
    return StateTraces(trial.name, first.time, curves, None if trial.truth is None else trial.truth.at(first.time))


def average_wrench(trials: Sequence[RobotTrialResult]) -> AveragedWrench | None:
    """Return the wrench, averaged over the repetitions of a cell's trials (figures 5.4 and 5.5).

    Only complete repetitions at full amplitude count, without run-in and run-out; None if there is no such repetition.
    """

    def read_wrench(result: MethodResult, suffix: str) -> FloatArray:
        return result.identified.dynamics[[f"{name}{suffix}" for name in WRENCH]].to_numpy(dtype=np.float64)

    series: dict[str, list[FloatArray]] = {}
    for trial in trials:
        first = trial.by_method[CAMERAS]
        wrenches = {"measured": read_wrench(first, "")} | {
            label: read_wrench(trial.by_method[method], "_model")
            for method, label in _MEASURED.items()
            if method in trial.by_method
        }
        if trial.method_of_reference is not None:
            wrenches["Ref."] = predict_reference(trial, trial.method_of_reference)[0]
        # x is in the direction of the robot's x axis.
        direction = np.array([first.sign, 1.0, first.sign])
        for start, end in _find_repetitions(first):
            at = start + _PHASE / 100 * (end - start)
            for name, wrench in wrenches.items():
                sampled = np.column_stack([np.interp(at, first.time, column) for column in wrench.T]) * direction
                series.setdefault(name, []).append(sampled)
    if not series:
        return None
    measured, *models = ((name, np.stack(one)) for name, one in series.items())
    errors = {name: model - measured[1] for name, model in models}
    cell = " ".join(trials[0].cell).strip()
    return AveragedWrench(cell, len(measured[1]), _PHASE, measured[1], dict(models), errors)


def _find_repetitions(result: MethodResult) -> list[tuple[float, float]]:
    """Return start and end, s, of each complete repetition at full amplitude; it begins in the positive direction.

    The robot runs in from rest and out to rest: there the amplitude grows and fades. Such a repetition is another
    movement, and would widen the band of the averaged wrench.
    """
    events = result.folder.table("events.parquet")
    complete = events["complete"]
    time, angle = result.time, result.identified.q[:, 0]
    speed = result.sign * result.identified.dq[:, 0]
    kept, extremes = [], []
    for start, end in zip(events["start"][complete], events["end"][complete], strict=True):
        first = (time > start) & (time < start + 0.2 * (end - start))
        is_positive = first.any() and np.nanmean(speed[first]) > 0
        half = 0.0 if is_positive else 0.5 * (end - start)
        if end + half <= time[-1]:
            kept.append((float(start + half), float(end + half)))
            inside = angle[(time >= start + half) & (time <= end + half)]
            extremes.append((np.nanmin(inside), np.nanmax(inside)))
    if not kept:
        return kept
    usual = np.median(extremes, axis=0)
    full = np.abs(np.asarray(extremes) - usual).max(axis=1) <= _FULL * np.ptp(usual)
    return [each for each, is_full in zip(kept, full, strict=True) if is_full]


def collect_page_data(data: CohortData, trials: Sequence[RobotTrialResult]) -> RobotStudyData:
    """Return the data of the page.

    The figures are about the slow shoulder and the fast elbow, or else about the joint and speed of the first trial.
    """
    passed = [trial for trial in trials if trial.by_method]
    slow, fast = (
        [trial for trial in passed if trial.cell == cell] or [trial for trial in passed if trial.cell == passed[0].cell]
        for cell in (("shoulder", "slow"), ("elbow", "fast"))
    )
    chosen = {cell[0].name for cell in (slow, fast) if cell}
    recoveries = []  # skeleton and states of a trial (figures 5.2 and 5.3)
    for trial in trials:
        if trial.name not in chosen:
            continue
        identified = trial.by_method[CAMERAS].identified
        planar, skeleton = identified.planar, identified.skeleton
        thinned = slice(None, None, max(1, len(planar.frames) // _FRAMES))
        own = sorted(set(planar.labels) & set(skeleton.markers))
        columns = np.array([planar.labels.index(label) for label in own], dtype=np.int64)
        points = planar.read_positions(columns, thinned, "xy", keep_bursts=True)
        recovery = Recovery(
            joint=trial.joint or skeleton.segments[-1],
            speed=trial.speed,
            paths={label: points[:, k] for k, label in enumerate(own)},
            segment=dict(zip(skeleton.markers, skeleton.segment.tolist(), strict=True)),
            local=dict(zip(skeleton.markers, skeleton.local, strict=True)),
            centre=skeleton.centres[0],
            traces=_collect_traces(trial),
        )
        recoveries.append(recovery)
    return RobotStudyData(
        study=data.study,
        trials=data.trials,
        overview=data.tables["trials"],
        tables={title: data.tables[name] for name, (title, *_) in TABLES.items()},
        recoveries=tuple(recoveries),
        averaged=average_wrench(fast) if fast else None,
        traces=_collect_traces(fast[0]) if fast else None,
    )


# The study: run every trial with every method; write the tables, the page, and the tables in a Markdown page.

_BEGIN, _END = "<!-- tables: written by `mocap-id validate robot` -->", "<!-- end of tables -->"
_ABOUT = (
    "Each table is a CSV and a Parquet file (units and meanings in the field metadata). A missing value is empty in "
    "CSV and NaN in Parquet. Rows with the source `thesis` are from its tables."
)


@dataclass(frozen=True)
class RobotStudyResult:
    """The result of a robot study."""

    folder: Path  # folder of tables and page
    trials: tuple[RobotTrialResult, ...]
    frames: Mapping[str, pd.DataFrame]  # tables by name
    document: Mapping[str, Any]  # content of validation.json

    @property
    def failed(self) -> tuple[TrialRun, ...]:
        """Trials that failed or were refused."""
        return tuple(trial.run for trial in self.trials if trial.run.exit_code != 0)

    @property
    def page(self) -> Path:
        return self.folder / PAGE


def validate_robot(
    files: Sequence[Path] | Callable[[Path], Path],
    out: Path,
    *,
    jobs: int = 1,
    tell: TrialCallback = lambda run: None,
    page: Path | None = None,
) -> RobotStudyResult:
    """Run a robot study, write its tables and page into ``out``, and return the result.

    ``files`` are a study's file, or trials' files. A function is called with the folder ``out/trials``, where it
    simulates a study if it is missing, and returns the study's file. The run folders of the trials are in ``out/runs``.
    ``tell`` is called with the result of each finished trial. ``page`` is a Markdown page whose tables are replaced;
    the figures are written to a folder beside it.

    Raises
    ------
    ConfigError
        A file is wrong; no trial was run.
    StoreError
        The folder is in use or cannot be written. The failure of a trial raises nothing; it is reported in the tables.
    """
    out, before = out.absolute(), ""
    if page is not None:
        try:
            before = page.read_text("utf-8")
        except OSError as error:
            raise ConfigError(f"{page}: the file cannot be read ({error.strerror})") from error
        if _BEGIN not in before or _END not in before:
            raise ConfigError(f"{page}: expected the lines `{_BEGIN}` and `{_END}`, which enclose the tables")
    files = (files(out / "trials"),) if callable(files) else tuple(files)
    study = load_robot_study(files)
    owner = find_owner_of_files(*files)
    configs = [replace(one, trial=replace(one.trial, out=out / "runs" / one.trial.name)) for one in study.trials]
    with converting_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    with Folder(out).locked():
        check_owner(out, owner, DOCUMENT)
        runs = run_trials([one.trial for one in configs], LocalBackend(jobs), tell, run=run_all_methods)
        trials = tuple(_read_result(study, one, run) for one, run in zip(configs, runs, strict=True))
        rows = list(trial_rows(trials))
        tables = {"trials": ResultTable.of(TRIALS, rows)}
        tables |= {name: ResultTable.of(_SCHEMAS[name], cell_rows(name, rows)) for name in TABLES}
        entries = []
        for trial in trials:
            orientation = "" if trial.orientation is None else f"{trial.orientation:g}°"
            movement = " ".join(filter(None, (trial.speed, orientation))) or "unlabelled"
            about = f"{trial.joint or 'joint'}, {movement}"
            entries.append(trial.entry(trial.name, about, f"runs/{trial.name}/report.html"))
        data = collect_page_data(CohortData(study.name, tuple(entries), tables), trials)
        content = {
            "study": study.name,
            "product": __version__,
            "about": _ABOUT,
            "page": PAGE,
            "trials": [
                {
                    "trial": trial.name,
                    "joint": trial.joint,
                    "speed": trial.speed,
                    "orientation": trial.orientation,
                    "exit_code": trial.run.exit_code,
                    "message": trial.run.published,
                    "truth": trial.truth is not None,
                    "against": trial.by_method[CAMERAS].row["against"] if trial.by_method else "",
                }
                for trial in trials
            ],
            "tables": {name: table.description for name, table in tables.items()},
        }

        def make_pages() -> dict[str, bytes]:
            markdown = f"# {data.study}\n\n{render_markdown(data, {})}"
            return {PAGE: render_robot_page(data), MARKDOWN: markdown.encode()}

        result = CommandResult("robot-study", DOCUMENT, content, tables, make_pages)
        result.write(out)
        store_owner(out, owner, DOCUMENT)
    if page is not None:
        from mocap_id.reporting import paper_figures  # noqa: PLC0415  it loads matplotlib

        # The tables between the marks in the page, and the figures in a folder with the page's name.
        drawings = draw_robot_figures(data)
        drawn = [one for one in drawings.all if not one.missing]
        links = {one.title: f"{page.stem}/{one.name}.svg" for one in drawn}
        made = paper_figures.make_figure_files(drawings)
        figures = {links[one.title]: made[f"figures/{one.name}.svg"] for one in drawn}
        head, rest = before.split(_BEGIN, 1)
        tail = rest.split(_END, 1)[1]
        markdown = f"{head}{_BEGIN}\n\n{render_markdown(data, links)}\n{_END}{tail}"
        write_files(page.parent, {**figures, page.name: markdown.encode()})
    return RobotStudyResult(out, trials, {name: table.frame for name, table in tables.items()}, result.document)
