"""Random smooth time functions: the irregularity of a motion and the sway of a body."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.simulation.joint_motion import smoothstep

TREMOR = (1.0, 5.0)  # Hz
SWAY = (0.08, 0.6)  # Hz
_WAVES = 8


def tremor(rng: np.random.Generator, time: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return angles (T, n) whose second derivatives have the given (n,) root mean squares, rad and rad/s²."""
    frequency, phase = _draw(rng, TREMOR, len(acceleration))
    omega = 2 * np.pi * frequency
    waves = np.sin(omega * time[:, None, None] + phase) / omega**2
    total: FloatArray = acceleration * waves.sum(axis=1) * np.sqrt(2 / _WAVES)
    return total


def sway(rng: np.random.Generator, time: FloatArray, size: FloatArray) -> FloatArray:
    """Return slow motion (T, n) with the given (n,) standard deviations; lower frequencies are larger."""
    frequency, phase = _draw(rng, SWAY, len(size))
    weight = 1 / frequency
    waves = np.sin(2 * np.pi * frequency * time[:, None, None] + phase) * weight
    total: FloatArray = size * waves.sum(axis=1) / np.sqrt((weight**2).sum(axis=0) / 2)
    return total


def since(time: FloatArray, start: float, over: float = 1.0) -> FloatArray:
    """Return (T, 1) a smooth step from 0 at ``start`` to 1 after ``over`` seconds."""
    step: FloatArray = smoothstep((time - start) / over)[:, None]
    return step


def _draw(rng: np.random.Generator, band: tuple[float, float], count: int) -> tuple[FloatArray, FloatArray]:
    return rng.uniform(*band, (_WAVES, count)), rng.uniform(0, 2 * np.pi, (_WAVES, count))
