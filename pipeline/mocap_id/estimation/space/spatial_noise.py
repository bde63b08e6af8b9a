"""Marker and process noise of a chain in space, from the poses of single frames.

The steps between frames, in each segment's own axes, sum up to one series for each degree of freedom. A series is
movement and white noise of known variance r. A snap of standard deviation s over one frame gives the smoother
H = 1 / (1 + (w / w0)^8) with w0^8 = s² / r. The snap is chosen for the least squared error of the smoothed acceleration,

    sum over frequencies of H² I − 2 H (I − N),

up to a constant, with the power I of the measured acceleration and the power N of its noise. The likelihood, in
contrast, is misled by slow movement, which has less power than white snap would give it. Only moving samples count,
because a still start would suggest less snap than the movement has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, chunks
from mocap_id.estimation.process_model import ORDER
from mocap_id.estimation.space.frame_poses import FramePoses
from mocap_id.estimation.space.space_kernels import ChainModel
from mocap_id.geometry import so3

SNAP_BOUNDS = (1e-1, 1e6)
"""Search range of the snap's standard deviation over one frame, rad/s⁴ or m/s⁴."""

_STILL = 0.3  # of the rms speed; slower samples do not count
_AROUND = 0.25  # s, about a moving sample, that count too
_WINDOW = 4.0  # s
_MOST = 100  # windows
_CAUTION = 1.3  # times the best snap: it costs little accuracy, and fast movement needs more than the average
_LEAST = 16  # frames of a window
_TRIALS = 120  # values of the snap


@dataclass(frozen=True)
class SpatialNoise:
    """Noise of the filter.

    Parameters
    ----------
    camera_sd : float
        Standard deviation of a marker's white noise, per coordinate, m.
    marker_sd : (M,) array
        The same with the lasting error of the skin, for each marker, m.
    snap : (d,) array
        Standard deviation of the snap of each degree of freedom, held over one frame, rad/s⁴ or m/s⁴.
    """

    camera_sd: float
    marker_sd: FloatArray
    snap: FloatArray


def camera_noise(frames: FramePoses, floor: float) -> float:
    """Return the standard deviation (m) of the markers' white noise, at least ``floor``.

    Second differences of the residuals remove lasting errors, and the share that the pose follows is added.
    """
    squares, freedom = 0.0, 0.0
    for s in chunks(len(frames.residual)):
        part = slice(s.start, s.stop + 2)
        off = np.where(frames.used[part, :, None], frames.residual[part], np.nan)
        bends = np.sum((off[2:] - 2 * off[1:-1] + off[:-2]) ** 2, axis=2)
        known = np.isfinite(bends)
        squares += float(np.sum(bends[known])) / 6.0
        freedom += 3.0 * float(np.sum((1.0 - frames.leverage[part][1:-1])[known]))
    return max(floor, math.sqrt(squares / freedom)) if freedom >= 1.0 else floor


def process_noise(model: ChainModel, frames: FramePoses, camera: float, dt: float) -> FloatArray:
    """Return the standard deviation of the snap (d,) of each degree of freedom over one frame.

    Parameters
    ----------
    model : ChainModel
    frames : FramePoses
    camera : float
        White noise of a coordinate, m.
    dt : float
        Time step, s.
    """
    series, variance = _series(model, frames), camera**2 * frames.white
    found = np.empty(series.shape[1])
    for group, columns in _groups(model):
        seen = frames.observed[:, group]
        moving = seen & _moving(series[:, columns], seen, dt)
        found[columns] = _best_snap(series[:, columns], variance[:, columns], moving, seen, dt)
    return found


def _groups(model: ChainModel) -> list[tuple[int, slice]]:
    """Return the columns that share one snap: position, rotation, ball, or a single coordinate; and their joint."""
    groups = [(0, slice(0, 3)), (0, slice(3, 6))]
    for k, at in enumerate(model.first[1:].tolist()):
        if model.ball[k]:
            groups.append((k + 1, slice(at, at + 3)))
        else:
            groups += [(k + 1, slice(at + c, at + c + 1)) for c in range(int(model.freedom[k]))]
    return groups


def _series(model: ChainModel, frames: FramePoses) -> FloatArray:
    """Return the sums (F, d) of the steps between frames."""
    track = frames.track
    steps = np.zeros(frames.white.shape)
    steps[:, :3] = track.origin
    for k in range(track.turn.shape[1]):
        at = int(model.first[k])
        if k == 0 or model.ball[k - 1]:
            turned = so3.log(np.swapaxes(track.turn[:-1, k], 1, 2) @ track.turn[1:, k])
            steps[1:, at : at + 3] = np.cumsum(turned, axis=0)
        else:
            steps[:, at : at + int(model.freedom[k - 1])] = track.angle[:, k - 1, : model.freedom[k - 1]]
    return steps


def _moving(series: FloatArray, seen: BoolArray, dt: float) -> BoolArray:
    """Return samples (F,) faster than a share of the rms speed, and those around them; all if the trial is too short."""
    half = max(round(_AROUND / dt / 2), 1)
    if len(series) < 8 * half:
        return np.ones(len(series), dtype=np.bool_)
    speed = np.zeros(len(series))
    speed[half:-half] = np.linalg.norm(series[2 * half :] - series[: -2 * half], axis=1)
    known = speed[seen]
    if not known.size:
        return np.ones(len(series), dtype=np.bool_)
    fast = speed > _STILL * np.sqrt(np.mean(known**2))
    around = np.convolve(fast, np.ones(4 * half + 1), mode="same") > 0
    return np.asarray(around, dtype=np.bool_)


def _best_snap(series: FloatArray, variance: FloatArray, moving: BoolArray, seen: BoolArray, dt: float) -> float:
    """Return the snap of the most accurate accelerations of some series (F, c) over the moving samples (F,)."""
    size = min(round(_WINDOW / dt), len(series) - 2)
    trials = np.geomspace(*SNAP_BOUNDS, _TRIALS)
    if size < _LEAST or not seen.any():
        return float(trials[-1])
    every = np.arange(len(series))
    starts = np.arange(0, len(series) - 1 - size, max(size // 2, 1))
    starts = np.array([k for k in starts if moving[k : k + size + 2].mean() > 0.5 and seen[k : k + size + 2].all()])
    if not starts.size:
        starts = np.array([max((len(series) - 2 - size) // 2, 0)])
    starts = starts[np.linspace(0, len(starts) - 1, min(len(starts), _MOST)).round().astype(np.int64)]
    taper = np.hanning(size)
    turning = 2 * np.pi * np.fft.rfftfreq(size, dt)
    shape = (2 - 2 * np.cos(turning * dt)) ** 2 * np.sum(taper**2)
    risk = np.zeros(_TRIALS)
    for c in range(series.shape[1]):
        filled = np.interp(every, every[seen], series[seen, c])
        bends = np.diff(filled, 2)
        windows = np.stack([bends[k : k + size] for k in starts])
        power = np.mean(np.abs(np.fft.rfft((windows - windows.mean(axis=1, keepdims=True)) * taper)) ** 2, axis=0)
        top = slice(len(turning) // 2, None)  # a poor geometry in some postures has more noise than the median
        white = max(float(np.median(variance[seen, c])), float(np.sum(power[top]) / np.sum(shape[top])))
        passed = 1 / (1 + turning ** (2 * ORDER) * (white / trials**2)[:, None])
        risk += np.sum(passed**2 * power - 2 * passed * (power - white * shape), axis=1)
    return _CAUTION * float(trials[np.argmin(risk)])
