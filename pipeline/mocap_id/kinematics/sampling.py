"""Which frames to look at: enough of every pose, and not too many of those that a person stays in."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray, chunks

_STILL_SHARE = 0.1  # of the frames, spread evenly over time whatever moves
_WINDOWS = 200  # stretches of the trial over which a movement is measured


def frames_along_motion(points: ComplexArray, count: int, among: IntArray | None = None) -> IntArray:
    """At most ``count`` frames, evenly along the path that the markers travel.

    Skin has the same error whenever the pose is the same: a hundred frames of quiet standing say no more than one, but
    would count a hundred times if frames were taken evenly in time.

    Parameters
    ----------
    points : (F, M) complex array
        Trajectories in the plane, m; NaN where unseen.
    count : int
    among : int array, optional
        Frames to choose from, ascending; all where not given.

    Returns
    -------
    int array
        Ascending.
    """
    among = np.arange(len(points)) if among is None else among
    frames = len(among)
    if frames <= count:
        return among
    speed = _speed(points, among, max(1, frames // _WINDOWS))
    moving = np.maximum(speed - np.quantile(speed, 0.05), 0)  # what stands still moves by its noise
    total = moving.mean()
    density = _STILL_SHARE + (1 - _STILL_SHARE) * (moving / total if total > 0 else np.ones(frames))
    travelled = np.cumsum(density)
    middles = (np.arange(count) + 0.5) / count * travelled[-1]
    return np.asarray(among[np.unique(np.searchsorted(travelled, middles))])


def _speed(points: ComplexArray, among: IntArray, window: int) -> FloatArray:
    """(A,) rms displacement of the markers over a window of frames ``among`` about each, of those seen at both ends."""
    rms = np.empty(len(among) - window)
    for here in chunks(len(rms)):
        step = np.abs(points[among[window:][here]] - points[among[here]])
        seen = np.isfinite(step)
        square = np.where(seen, step, 0) ** 2
        rms[here] = np.sqrt(square.sum(axis=1) / np.maximum(seen.sum(axis=1), 1))
    before = window // 2
    return np.pad(rms, (before, window - before), mode="edge")
