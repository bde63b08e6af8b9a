"""Choice of frames for a fit: enough frames of every posture, and few of postures that last long."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray, chunks

_STILL_SHARE = 0.1  # fraction of the frames that is spread evenly over time
_RESTING = 0.1  # fraction of the largest speed; slower markers are at rest
_WINDOWS = 200  # windows of a trial, over which the speed is measured


def frames_along_motion(points: ComplexArray | FloatArray, count: int, among: IntArray | None = None) -> IntArray:
    """Return at most ``count`` frames, ascending, evenly spaced along the path of the markers.

    Skin has the same error in the same posture. A hundred frames of quiet standing contain as much information as one,
    but would have a hundred times its weight if the frames were evenly spaced in time. Trajectories are complex (F, M)
    in the plane, or (F, M, 3) in space, m, NaN where missing. The frames are chosen from ``among``, by default from
    all.
    """
    among = np.arange(len(points)) if among is None else among
    frames = len(among)
    if frames <= count:
        return among
    speed = _speed(points, among, max(1, frames // _WINDOWS))
    moving = np.maximum(speed - np.quantile(speed, 0.05), 0)  # still markers move by noise only
    total = moving.mean()
    density = _STILL_SHARE + (1 - _STILL_SHARE) * (moving / total if total > 0 else np.ones(frames))
    travelled = np.cumsum(density)
    middles = (np.arange(count) + 0.5) / count * travelled[-1]
    return np.asarray(among[np.unique(np.searchsorted(travelled, middles))])


def frames_over_time(points: ComplexArray, count: int) -> IntArray:
    """Return at most ``count`` frames, evenly spaced in time, or along the motion if the points (F, M) mostly rest."""
    every = np.arange(len(points))
    if len(every) <= count:
        return every
    window = max(1, len(every) // _WINDOWS)
    visible = np.isfinite(points)
    known = (visible[window:] & visible[:-window]).mean(axis=1) > 0.5
    speed = _speed(points, every, window)[window // 2 :][: len(known)][known]
    if known.mean() > 0.5 and np.median(speed) < _RESTING * np.quantile(speed, 0.95):
        return frames_along_motion(points, count)
    return np.unique(np.linspace(0, every[-1], count).round().astype(np.int64))


def _speed(points: ComplexArray | FloatArray, among: IntArray, window: int) -> FloatArray:
    """Return the rms displacement (A,), m, of visible markers over ``window`` frames around the A frames ``among``."""
    rms = np.empty(len(among) - window)
    for here in chunks(len(rms)):
        moved = points[among[window:][here]] - points[among[here]]
        step = np.abs(moved) if moved.ndim == 2 else np.linalg.norm(moved, axis=2)
        seen = np.isfinite(step)
        square = np.where(seen, step, 0) ** 2
        rms[here] = np.sqrt(square.sum(axis=1) / np.maximum(seen.sum(axis=1), 1))
    before = window // 2
    return np.pad(rms, (before, window - before), mode="edge")
