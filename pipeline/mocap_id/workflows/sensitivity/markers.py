"""Perturbations of the markers: noise, skin, drop-outs, their number, the frame rate, and noise of the angles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry.planar import marker_positions, rotate
from mocap_id.stages.trajectories import PlanarView
from mocap_id.store import Table
from mocap_id.workflows.sensitivity.plan import Perturbation
from mocap_id.workflows.sensitivity.signals import WRENCH, joints_of
from mocap_id.workflows.sensitivity.subject import Perturbed
from mocap_id.workflows.simulate import skin
from mocap_id.workflows.simulate.markers import MarkerSet

PLANAR, SEGMENTS = "planar.parquet", "segments.parquet"
_BURST = (0.05, 0.5)  # s, shortest and longest drop-out


def camera_noise(trial: Perturbed, change: Perturbation) -> Perturbed:
    """Add white noise to every coordinate of every marker on a moving segment."""
    moving = _moving(trial)
    noise = change.rng().standard_normal((len(_time(trial)), len(moving), 2))
    return _shifted(trial, moving, change.level * noise)


def angle_noise(trial: Perturbed, change: Perturbation) -> Perturbed:
    """Turn the markers by white noise in the angles, so that the filter sees what it would see of such angles.

    The markers move by the difference of two forward maps (3.18), with the noise and without: a frame's own angles are
    then off by exactly that noise, all else is as it was, and the chain is kept.
    """
    q = _whole(trial.states("theta"))
    noisy = q.copy()
    joints = joints_of(trial, change)
    noisy[:, joints] += change.level * change.rng().standard_normal((len(q), len(joints)))
    chain = [trial.node("chain.h5", *at) for at in (("joints", "centre"), ("markers", "segment"), ("markers", "local"))]
    columns = _columns(trial, [str(label) for label in trial.node("chain.h5", "markers", "name")])
    return _shifted(trial, columns, marker_positions(noisy, *chain) - marker_positions(q, *chain))


def soft_tissue(trial: Perturbed, change: Perturbation) -> Perturbed:
    """Let the skin slide as the simulation does it: by up to the level, with the joint angles, and a slow wander."""
    moving, segment = _moving(trial), _segment(trial)
    q = _whole(trial.states("theta"))
    count = len(moving)
    markers = MarkerSet(
        labels=tuple(map(str, range(count))),
        link=segment[moving],
        local=np.zeros((count, 3)),
        softness=np.ones(count),
        hidden=np.zeros(count, dtype=np.bool_),
        on_plate=np.zeros(count, dtype=np.bool_),
        at_joint=(None,) * count,
    )
    slide = skin.of_a_trial(change.rng(), markers, q, _time(trial))[..., :2]
    turned = np.cumsum(q, axis=1)[:, segment[moving] - 1]  # (T, M) of each marker's segment
    return _shifted(trial, moving, change.level * rotate(turned, slide))


def drop_outs(trial: Perturbed, change: Perturbation) -> Perturbed:
    """Lose markers of the moving segments in bursts, until the level's share of their samples is gone."""
    moving, time = _moving(trial), _time(trial)
    lost = np.zeros((len(time), len(moving)), dtype=np.bool_)
    bursts, gone = _bursts(change.rng(), lost.shape, time[1] - time[0]), 0
    while gone < change.level * lost.size:
        frames, marker = next(bursts)
        gone += int(np.count_nonzero(~lost[frames, marker]))
        lost[frames, marker] = True
    everywhere = np.zeros((len(time), len(_segment(trial))), dtype=np.bool_)
    everywhere[:, moving] = lost
    return trial.having(_without(trial.table(PLANAR), everywhere))


def _bursts(rng: np.random.Generator, shape: tuple[int, ...], dt: float) -> Iterator[tuple[slice, int]]:
    """Frames and marker of one drop-out after the other."""
    frames, markers = shape
    while True:
        start, marker = int(rng.integers(frames)), int(rng.integers(markers))
        yield slice(start, start + max(1, round(rng.uniform(*_BURST) / dt))), marker


def marker_count(trial: Perturbed, change: Perturbation) -> Perturbed:
    """Leave so many markers, drawn at random, on every moving segment that has more."""
    table, rng = trial.table(SEGMENTS), change.rng()
    segment = table.frame["segment"].copy()
    for number in sorted(set(segment.dropna()) - {0}):
        own = np.flatnonzero((segment == number).fillna(False).to_numpy(dtype=np.bool_))
        segment.iloc[rng.permutation(own)[int(change.level) :]] = pd.NA
    return trial.having(replace(table, frame=table.frame.assign(segment=segment)))


def frame_rate(trial: Perturbed, change: Perturbation) -> Perturbed:
    """Keep every so many-th frame, and average the wrench over the longer interval, as planarise would."""
    every = int(change.level)
    if every == 1:
        return trial
    planar, wrench = trial.table(PLANAR), trial.table(WRENCH)
    count = len(_segment(trial))
    kept = np.arange(len(planar.frame)) // count % every == 0
    facts = {**planar.facts, "rate_hz": planar.facts["rate_hz"] / every}
    thinned = replace(planar, frame=planar.frame[kept].reset_index(drop=True), facts=facts)
    return trial.having(thinned, replace(wrench, frame=_averaged(wrench.frame, every)))


def _averaged(frame: pd.DataFrame, every: int) -> pd.DataFrame:
    """Means over so many rows about every so many-th; half of the outer two where the number is even."""
    weight = np.ones(every) if every % 2 else np.r_[0.5, np.ones(every - 1), 0.5]
    reach = len(weight) // 2
    still = frame[["time", "plate_ok"]]
    values = np.pad(frame.drop(columns=still.columns).to_numpy(np.float64), ((reach, reach), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(values, len(weight), axis=0)[::every]
    means = pd.DataFrame(windows @ (weight / every), columns=frame.columns.drop(list(still.columns)))
    thinned = still.iloc[::every].reset_index(drop=True)
    return pd.concat([thinned, means], axis=1)[list(frame.columns)]


def _time(trial: Perturbed) -> FloatArray:
    return trial.table("states.parquet").frame["time"].to_numpy(np.float64)


def _columns(trial: Perturbed, labels: list[str]) -> IntArray:
    """Where markers stand among those of planar.parquet."""
    known = PlanarView.of(trial.table(PLANAR)).labels
    return np.array([known.index(label) for label in labels], dtype=np.int64)


def _segment(trial: Perturbed) -> IntArray:
    """Segment of every marker of planar.parquet, -1 = none."""
    frame = trial.table(SEGMENTS).frame
    found = np.full(len(trial.table(PLANAR).frame["marker"].cat.categories), -1)
    found[_columns(trial, [str(label) for label in frame["marker"]])] = frame["segment"].fillna(-1).astype(int)
    return found


def _moving(trial: Perturbed) -> IntArray:
    return np.flatnonzero(_segment(trial) > 0)


def _whole(angles: FloatArray) -> FloatArray:
    """Angles (T, n) with the unknown ones interpolated."""
    found = angles.copy()
    for column in found.T:
        known = np.isfinite(column)
        if not known.all() and known.any():
            column[~known] = np.interp(np.flatnonzero(~known), np.flatnonzero(known), column[known])
    return found


def _shifted(trial: Perturbed, columns: IntArray, shift: FloatArray) -> Perturbed:
    """The trial with some markers moved by (F, m, 2), m."""
    table = trial.table(PLANAR)
    view = PlanarView.of(table)
    moved = {}
    for axis, (name, values) in enumerate((("x", view.x), ("y", view.y))):
        moved[name] = values.copy()
        moved[name][:, columns] += shift[..., axis]
    return trial.having(replace(table, frame=table.frame.assign(**{k: v.reshape(-1) for k, v in moved.items()})))


def _without(table: Table, lost: BoolArray) -> Table:
    """planar.parquet without some samples (F, M)."""
    gone = lost.reshape(-1)
    frame = table.frame
    seen = {name: np.where(gone, np.nan, frame[name].to_numpy(np.float64)) for name in ("x", "y", "z")}
    return replace(table, frame=frame.assign(**seen, visible=frame["visible"].to_numpy(np.bool_) & ~gone))
