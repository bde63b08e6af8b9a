"""What slipping skin, and a chain fitted to it, do to the angles that the markers give and to their derivatives."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.kinematics.skin_slides import SkinModel

_MEAN_OF = 400  # postures
_RATE = 30.0  # Hz; postures a second at which the errors are computed, a movement's own frequencies being below 3 Hz
_CHUNK = 500  # postures at a time, to bound the memory
_OVERLAP = 3  # postures that the next chunk has in common with this one, for the derivatives


def angle_errors(skin: SkinModel, angles: FloatArray, rate: float) -> tuple[IntArray, FloatArray]:
    """Variance of the errors of angle and derivatives that last: those of skin, and of the chain's geometry.

    Parameters
    ----------
    skin : SkinModel
    angles : (F, n) array
        Angle of each joint, rad, finite.
    rate : float
        Frames per second.

    Returns
    -------
    frames : (T,) int array
        At which the variances are given.
    variance : (T, n, 4) array
        Of angle less its mean error, velocity, acceleration and jerk of each joint, SI.
    """
    step = max(1, round(rate / _RATE))
    frames = np.arange(0, len(angles), step)
    mean = skin.errors(angles[frames[:: max(1, len(frames) // _MEAN_OF)]])[0].mean(axis=0)
    parts = [_variance(skin, angles[frames[own]], mean, step / rate)[kept] for own, kept in _chunks(len(frames))]
    return frames, np.concatenate(parts)


def _variance(skin: SkinModel, angles: FloatArray, mean: FloatArray, step: float) -> FloatArray:
    """(T, n, 4) summed squares of the errors and of their derivatives."""
    errors, unshaped = skin.errors(angles)
    part, parts = errors - mean, []
    for _ in range(4):
        parts.append(np.sum(part**2, axis=2))
        part = np.gradient(part, step, axis=0) if len(part) > 1 else np.zeros_like(part)
    parts[0] = parts[0] + unshaped
    return np.stack(parts, axis=2)


def _chunks(count: int) -> Iterator[tuple[slice, slice]]:
    """Stretches of postures with their neighbours, and which of each stretch are its own."""
    for start in range(0, count, _CHUNK):
        first = max(start - _OVERLAP, 0)
        stop = min(start + _CHUNK, count)
        yield slice(first, min(stop + _OVERLAP, count)), slice(start - first, stop - first)
