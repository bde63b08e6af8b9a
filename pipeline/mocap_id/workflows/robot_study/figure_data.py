"""The data of a robot study's figures: the recovery of one joint, and wrenches averaged over repetitions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from mocap_id.arrays import FloatArray
from mocap_id.reporting.robot_study.page_data import AveragedWrench, Recovery, StateTraces
from mocap_id.workflows.robot_study.method_results import WRENCH, MethodResult
from mocap_id.workflows.robot_study.methods import CAMERAS, DIFFERENCES, ENCODER
from mocap_id.workflows.robot_study.trial_results import RobotTrialResult, predict_reference

_PHASE = np.linspace(0.0, 100.0, 51)  # % of a repetition
_FRAMES = 60  # number of drawn frames of a marker's path
_FULL = 0.05  # largest difference of a repetition's extreme angles from the usual ones, divided by the usual range


def select_cell(trials: Sequence[RobotTrialResult], joint: str, speed: str) -> list[RobotTrialResult]:
    """Return the trials with results for a joint and speed, or else for the joint and speed of the first trial."""
    passed = [trial for trial in trials if trial.by_method]
    in_cell = [trial for trial in passed if trial.cell == (joint, speed)]
    return in_cell or [trial for trial in passed if trial.cell == passed[0].cell]


def collect_recovery(trial: RobotTrialResult) -> Recovery:
    """Return the data of the figures about skeleton and states of a trial (figures 5.2 and 5.3)."""
    identified = trial.by_method[CAMERAS.name].identified
    planar, skeleton = identified.planar, identified.skeleton
    thinned = slice(None, None, max(1, len(planar.frames) // _FRAMES))
    own = sorted(set(planar.labels) & set(skeleton.markers))
    columns = np.array([planar.labels.index(label) for label in own], dtype=np.int64)
    points = planar.read_positions(columns, thinned, "xy", keep_bursts=True)
    paths = {label: points[:, k] for k, label in enumerate(own)}
    return Recovery(
        trial=trial.name,
        joint=trial.labels.joint or skeleton.segments[-1],
        speed=trial.labels.speed,
        paths=paths,
        segment=dict(zip(skeleton.markers, skeleton.segment.tolist(), strict=True)),
        local=dict(zip(skeleton.markers, skeleton.local, strict=True)),
        centre=skeleton.centres[0],
        traces=collect_traces(trial),
    )


def collect_traces(trial: RobotTrialResult) -> StateTraces:
    """Return the joint states over time from the UKF and from differences, in the robot's coordinate frame."""
    first = trial.by_method[CAMERAS.name]
    zero = np.array([first.frame.zero, 0.0, 0.0])
    curves = {
        method.thesis: first.frame.sign * (trial.by_method[method.name].joint_states - zero)
        for method in (CAMERAS, DIFFERENCES)
        if method.name in trial.by_method
    }
    return StateTraces(trial.name, first.time, curves, None if trial.truth is None else trial.truth.at(first.time))


def average_wrench(trials: Sequence[RobotTrialResult]) -> AveragedWrench | None:
    """Return the wrench, averaged over the repetitions of a cell's trials (figures 5.4 and 5.5).

    Only complete repetitions at full amplitude count, without run-in and run-out.

    None if there is no such repetition.
    """
    measured: list[FloatArray] = []
    models: dict[str, list[FloatArray]] = {}
    for trial in trials:
        first = trial.by_method[CAMERAS.name]
        for start, end in _find_repetitions(first):
            measured.append(_sample(first, _read_wrench(first.identified.dynamics, ""), start, end))
            for name, series in _predict_wrench(trial).items():
                models.setdefault(name, []).append(_sample(first, series, start, end))
    if not measured:
        return None
    own, stacked = np.stack(measured), {name: np.stack(series) for name, series in models.items()}
    errors = {name: series - own for name, series in stacked.items()}
    return AveragedWrench(" ".join(trials[0].cell).strip(), len(own), _PHASE, own, stacked, errors)


def _predict_wrench(trial: RobotTrialResult) -> Mapping[str, FloatArray]:
    """Return the wrench (T, 3) of each model by the model's label in the thesis."""
    models = {
        method.thesis: _read_wrench(trial.by_method[method.name].identified.dynamics, "_model")
        for method in (ENCODER, CAMERAS)
        if method.name in trial.by_method
    }
    through = trial.method_of_reference
    return models if through is None else models | {"Ref.": predict_reference(trial, through)[0]}


def _read_wrench(dynamics: pd.DataFrame, suffix: str) -> FloatArray:
    return dynamics[[f"{name}{suffix}" for name in WRENCH]].to_numpy(dtype=np.float64)


def _sample(result: MethodResult, wrench: FloatArray, start: float, end: float) -> FloatArray:
    """Return the wrench (P, 3) at the P phases of one repetition, with x in the direction of the robot's x axis."""
    at = start + _PHASE / 100 * (end - start)
    direction = np.array([result.frame.sign, 1.0, result.frame.sign])
    return np.asarray(np.column_stack([np.interp(at, result.time, column) for column in wrench.T]) * direction)


def _find_repetitions(result: MethodResult) -> list[tuple[float, float]]:
    """Return start and end, s, of each complete repetition at full amplitude; it begins in the positive direction.

    The robot runs in from rest and out to rest: there the amplitude grows and fades. Such a repetition is another
    movement, and would widen the band of the averaged wrench.
    """
    events = result.folder.table("events.parquet")
    complete = events["complete"]
    time, angle = result.time, result.identified.q[:, 0]
    speed = result.frame.sign * result.identified.dq[:, 0]
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
