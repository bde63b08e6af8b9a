"""Series for the figures of a robot study: one joint's recovery, and wrenches averaged over repetitions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from mocap_id.arrays import FloatArray
from mocap_id.reporting.robot.material import Averaged, Recovery, Traces
from mocap_id.store import Folder, Table
from mocap_id.workflows.robot_study.obtained import PARAMETERS, WRENCH, Obtained
from mocap_id.workflows.robot_study.rows import Case, reference_series
from mocap_id.workflows.robot_study.variants import CAMERAS, DIFFERENCES, ENCODER

_PHASE = np.linspace(0.0, 100.0, 51)  # % of a repetition
_FRAMES = 60  # of a marker's way that are drawn


def choose(cases: Sequence[Case], joint: str, speed: str) -> list[Case]:
    """The trials of a cell that went through, or those of the first cell where it has none."""
    through = [one for one in cases if one.by_method]
    wanted = [one for one in through if (one.labels.joint, one.labels.speed) == (joint, speed)]
    if wanted or not through:
        return wanted
    first = through[0].labels
    return [one for one in through if (one.labels.joint, one.labels.speed) == (first.joint, first.speed)]


def recovery(one: Case) -> Recovery:
    """How the skeleton and the states of a trial came about (figures 5.2 and 5.3)."""
    found = one.by_method[CAMERAS.name]
    planar, skeleton = found.done.planar, found.done.skeleton
    thinned = slice(None, None, max(1, len(planar.frames) // _FRAMES))
    own = sorted(set(planar.labels) & set(skeleton.markers))
    paths = {label: planar.points(np.array([planar.labels.index(label)]), thinned)[:, 0] for label in own}
    return Recovery(
        trial=one.name,
        joint=one.labels.joint or skeleton.segments[-1],
        speed=one.labels.speed,
        paths=paths,
        segment=dict(zip(skeleton.markers, skeleton.segment.tolist(), strict=True)),
        local=dict(zip(skeleton.markers, skeleton.local, strict=True)),
        centre=skeleton.centres[0],
        traces=traces(one),
    )


def traces(one: Case) -> Traces:
    """The joint's states over time by cameras and by differences, in the robot's sense."""
    curves, first = {}, one.by_method[CAMERAS.name]
    time, zero = first.done.dynamics["time"].to_numpy(dtype=np.float64), np.array([first.gauge.zero, 0.0, 0.0])
    for method in (CAMERAS, DIFFERENCES):
        if method.name in one.by_method:
            done = one.by_method[method.name].done
            states = np.column_stack([done.q[:, 0], done.dq[:, 0], done.ddq[:, 0]])
            curves[method.thesis] = first.gauge.sign * (states - zero)
    return Traces(one.name, time, curves, None if one.truth is None else one.truth.at(time))


def averaged(cases: Sequence[Case]) -> Averaged | None:
    """Wrench over the repetitions of all trials of a cell (figures 5.4 and 5.5); None where none is complete."""
    measured: list[FloatArray] = []
    models: dict[str, list[FloatArray]] = {}
    for one in cases:
        for start, end in _repetitions(one):
            first = one.by_method[CAMERAS.name]
            measured.append(_cut(first, _columns(first.done.dynamics, ""), start, end))
            for name, series in _series(one).items():
                models.setdefault(name, []).append(_cut(first, series, start, end))
    if not measured:
        return None
    own = np.stack(measured)
    errors = {name: np.stack(series) - own for name, series in models.items()}
    label = cases[0].labels
    return Averaged(
        f"{label.joint} {label.speed}".strip(),
        len(own),
        _PHASE,
        own,
        {name: np.stack(series) for name, series in models.items()},
        errors,
    )


def _series(one: Case) -> Mapping[str, FloatArray]:
    """Wrench (T, 3) of every model, by what the thesis calls it."""
    found = {}
    for method in (ENCODER, CAMERAS):
        if method.name in one.by_method:
            found[method.thesis] = _columns(one.by_method[method.name].done.dynamics, "_model")
    if all(name in one.reference for name in PARAMETERS):
        through = one.by_method.get(ENCODER.name) or one.by_method[CAMERAS.name]
        found["Ref."] = reference_series(one, through)[0]
    return found


def _columns(dynamics: pd.DataFrame, suffix: str) -> FloatArray:
    return dynamics[[f"{name}{suffix}" for name in WRENCH]].to_numpy(dtype=np.float64)


def _cut(found: Obtained, wrench: FloatArray, start: float, end: float) -> FloatArray:
    """One repetition (P, 3), in the robot's sense of x."""
    time = found.done.dynamics["time"].to_numpy(dtype=np.float64)
    at = start + _PHASE / 100 * (end - start)
    sense = np.array([found.gauge.sign, 1.0, found.gauge.sign])
    return np.asarray(np.column_stack([np.interp(at, time, column) for column in wrench.T]) * sense)


def _repetitions(one: Case) -> list[tuple[float, float]]:
    """Start and end of the complete ones, s, each beginning towards the robot's positive side."""
    found = one.by_method[CAMERAS.name]
    events = _table(Folder(found.done.source), "events.parquet")
    whole = events["complete"]
    time, speed = found.done.dynamics["time"].to_numpy(dtype=np.float64), found.gauge.sign * found.done.dq[:, 0]
    kept = []
    for start, end in zip(events["start"][whole], events["end"][whole], strict=True):
        within = (time > start) & (time < start + 0.2 * (end - start))
        forwards = within.any() and np.nanmean(speed[within]) > 0
        half = 0.0 if forwards else 0.5 * (end - start)
        if end + half <= time[-1]:
            kept.append((float(start + half), float(end + half)))
    return kept


def _table(folder: Folder, file: str) -> Table:
    artefact = folder.read(file)
    assert isinstance(artefact, Table)
    return artefact
