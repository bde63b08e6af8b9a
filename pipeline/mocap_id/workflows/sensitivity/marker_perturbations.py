"""Perturbations of the markers: noise, skin motion, drop-outs, fewer markers, lower frame rate, noise of the angles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from mocap_id.anatomy.skin_motion import draw_centred_skin_motion
from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry.planar import marker_positions, rotate
from mocap_id.store import LongTable, Table
from mocap_id.workflows.sensitivity.plan import Perturbation
from mocap_id.workflows.sensitivity.signal_perturbations import WRENCH, joints_of
from mocap_id.workflows.sensitivity.trial_inputs import TrialInputs

PLANAR, SEGMENTS = "planar.parquet", "segments.parquet"
_BURST = (0.05, 0.5)  # s, shortest and longest drop-out


def camera_noise(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial with white noise added to each coordinate of each marker on a moving segment."""
    moving = _find_moving(trial)
    noise = change.rng().standard_normal((len(trial.time), len(moving), 2))
    return _shift(trial, moving, change.level * noise)


def angle_noise(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial with its markers shifted as by white noise in the angles.

    The shift is the difference between the marker positions (3.18) with and without the noise. The angles of each frame
    then have exactly this error, and the chain does not change.
    """
    q = _fill_gaps(trial.states("theta"))
    noisy = q.copy()
    joints = joints_of(trial, change)
    noisy[:, joints] += change.level * change.rng().standard_normal((len(q), len(joints)))
    tree = trial.tree("chain.h5")
    chain = [tree.array(path) for path in ("joints/centre", "markers/segment", "markers/local")]
    columns = _find_columns(trial, tree.texts("markers/name"))
    return _shift(trial, columns, marker_positions(noisy, *chain) - marker_positions(q, *chain))


def soft_tissue(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial with simulated skin motion up to the level, m, which depends on the angles and drifts slowly."""
    moving, segment = _find_moving(trial), _read_segments(trial)
    q = _fill_gaps(trial.states("theta"))
    slide = draw_centred_skin_motion(change.rng(), segment[moving], np.ones(len(moving)), q, trial.time)[..., :2]
    angle = np.cumsum(q, axis=1)[:, segment[moving] - 1]  # (T, M) angle of each marker's segment
    return _shift(trial, moving, change.level * rotate(angle, slide))


def drop_outs(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial without bursts of samples of moving markers; the level is the removed fraction of samples."""
    moving, time = _find_moving(trial), trial.time
    missing = np.zeros((len(time), len(moving)), dtype=np.bool_)
    bursts, removed = _draw_bursts(change.rng(), missing.shape, time[1] - time[0]), 0
    while removed < change.level * missing.size:
        frames, marker = next(bursts)
        removed += int(np.count_nonzero(~missing[frames, marker]))
        missing[frames, marker] = True
    everywhere = np.zeros((len(time), len(_read_segments(trial))), dtype=np.bool_)
    everywhere[:, moving] = missing
    return trial.with_artefacts(_remove_samples(trial.long(PLANAR), everywhere))


def _draw_bursts(rng: np.random.Generator, shape: tuple[int, ...], dt: float) -> Iterator[tuple[slice, int]]:
    """Yield endless random drop-outs, each as its frames and its marker; ``dt`` is the time between frames, s."""
    frames, markers = shape
    while True:
        start, marker = int(rng.integers(frames)), int(rng.integers(markers))
        yield slice(start, start + max(1, round(rng.uniform(*_BURST) / dt))), marker


def marker_count(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial with at most ``level`` markers, chosen at random, on each moving segment."""
    table, rng = trial.table(SEGMENTS), change.rng()
    segment = table["segment"].copy()
    for number in sorted(set(segment[segment > 0])):
        segment[rng.permutation(np.flatnonzero(segment == number))[int(change.level) :]] = -1
    return trial.with_artefacts(table.with_columns(segment=segment))


def frame_rate(trial: TrialInputs, change: Perturbation) -> TrialInputs:
    """Return the trial with its frame rate divided by the level; the wrench is averaged as in planarise."""
    every = int(change.level)
    if every == 1:
        return trial
    planar, wrench = trial.long(PLANAR), trial.table(WRENCH)
    thinned = replace(
        planar,
        frames=planar.frames[::every],
        time=planar.time[::every],
        values={name: values[::every] for name, values in planar.values.items()},
        facts={**planar.facts, "rate_hz": planar.facts["rate_hz"] / every},
    )
    return trial.with_artefacts(thinned, _average(wrench, every))


def _average(table: Table, every: int) -> Table:
    """Return each ``every``-th row, as the mean of the ``every`` rows around it.

    If ``every`` is even, the two outer rows of each mean have half the weight.
    """
    weight = np.ones(every) if every % 2 else np.r_[0.5, np.ones(every - 1), 0.5]
    reach = len(weight) // 2
    columns = {}
    for name, values in table.columns.items():
        if name in ("time", "plate_ok"):
            columns[name] = values[::every]
        else:
            windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, reach, mode="edge"), len(weight))
            columns[name] = windows[::every] @ (weight / every)
    return replace(table, columns=columns)


def _find_columns(trial: TrialInputs, labels: Sequence[str]) -> IntArray:
    """Return the columns of the markers with these labels in planar.parquet."""
    known = trial.long(PLANAR).labels
    return np.array([known.index(label) for label in labels], dtype=np.int64)


def _read_segments(trial: TrialInputs) -> IntArray:
    """Return the segment of each marker in planar.parquet; -1 for a marker without a segment."""
    table = trial.table(SEGMENTS)
    segment = np.full(len(trial.long(PLANAR).labels), -1)
    segment[_find_columns(trial, list(table["marker"]))] = table["segment"]
    return segment


def _find_moving(trial: TrialInputs) -> IntArray:
    """Return the columns of the markers on moving segments."""
    return np.flatnonzero(_read_segments(trial) > 0)


def _fill_gaps(angles: FloatArray) -> FloatArray:
    """Return the angles (T, n) with linearly interpolated gaps; a column without known values stays NaN."""
    filled = angles.copy()
    for column in filled.T:
        known = np.isfinite(column)
        if not known.all() and known.any():
            column[~known] = np.interp(np.flatnonzero(~known), np.flatnonzero(known), column[known])
    return filled


def _shift(trial: TrialInputs, columns: IntArray, shift: FloatArray) -> TrialInputs:
    """Return the trial with the markers in ``columns`` (m,) shifted by ``shift`` (F, m, 2), metres."""
    table = trial.long(PLANAR)
    values = dict(table.values)
    for axis, name in enumerate("xy"):
        values[name] = values[name].copy()
        values[name][:, columns] += shift[..., axis]
    return trial.with_artefacts(replace(table, values=values))


def _remove_samples(table: LongTable, missing: BoolArray) -> LongTable:
    """Return planar.parquet without the samples that ``missing`` (F, M) marks."""
    seen = {name: np.where(missing, np.nan, table.values[name]) for name in ("x", "y", "z")}
    return replace(table, values={**seen, "visible": table.values["visible"].astype(np.bool_) & ~missing})
