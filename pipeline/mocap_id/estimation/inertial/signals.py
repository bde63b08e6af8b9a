"""Signals of an inertial sensor, and the motion of the segment that carries it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from mocap_id.arrays import BoolArray, FloatArray

GRAVITY = 9.81
"""m/s², along y of the trial's frame."""

_GAP = 2.5  # usual steps between samples; a longer one is a gap
_AVERAGED = 1.5  # samples in a frame; if there are more, they are averaged
_PINNED = 3  # successive samples at the largest value of a channel that are saturated


@dataclass(frozen=True)
class SegmentMotion:
    """Motion of a segment at F frames, in its own axes; NaN where unknown.

    Parameters
    ----------
    omega, alpha : (F, 3) arrays
        Angular velocity and acceleration, rad/s and rad/s².
    force : (F, 3) array
        Acceleration of the origin minus gravity, m/s².
    twist, twist_rate : (F,) arrays
        Twist against the parent about the long axis, rad, and its rate, rad/s; zero for the base.
    long_axis : (3,) array
        Unit vector.
    """

    omega: FloatArray
    alpha: FloatArray
    force: FloatArray
    twist: FloatArray
    twist_rate: FloatArray
    long_axis: FloatArray

    @property
    def known(self) -> BoolArray:
        """Where (F,) the motion is known."""
        return np.asarray(np.isfinite(self.omega[:, 0] + self.alpha[:, 0] + self.force[:, 0] + self.twist_rate))


@dataclass(frozen=True)
class SensorSignals:
    """Samples of a sensor on its own clock.

    Parameters
    ----------
    time : (K,) array
        Increasing times, s.
    gyro, acc : (K, 3) arrays
        Angular velocity, rad/s, and specific force, m/s², in the sensor's axes.
    """

    time: FloatArray
    gyro: FloatArray
    acc: FloatArray

    @cached_property
    def rate(self) -> float:
        """Samples per second."""
        return float(1.0 / np.median(np.diff(self.time)))

    @cached_property
    def saturated(self) -> BoolArray:
        """Where (K,) a channel stays at its largest or smallest value."""
        both = np.concatenate([self.gyro, self.acc], axis=1)
        found = np.zeros(len(both), dtype=np.bool_)
        for values in (both, -both):
            top = (values == values.max(axis=0)) & (values.max(axis=0) > 4 * np.std(values, axis=0))
            successive = np.stack([top[k : len(top) - _PINNED + 1 + k] for k in range(_PINNED)])
            run = np.asarray(np.any(np.all(successive, axis=0), axis=1))
            for k in range(_PINNED):
                found[k : len(run) + k] |= run
        return found

    @cached_property
    def noise(self) -> FloatArray:
        """Standard deviations (2,) of one sample's white noise: gyroscope, accelerometer."""
        found = []
        for values in (self.gyro, self.acc):
            bends = np.abs(np.diff(values, 3, axis=0))
            step = np.unique(np.abs(np.diff(values[:, 0])))
            least = float(step[step > 0].min(initial=np.inf)) / np.sqrt(12) if len(step) > 1 else 0.0
            quiet = np.quantile(bends, 0.5, axis=0) / (0.6745 * np.sqrt(20.0))
            found.append(max(float(np.sqrt(np.mean(quiet**2))), least if np.isfinite(least) else 0.0, 1e-9))
        return np.array(found)

    @cached_property
    def _splines(self) -> CubicSpline:
        return CubicSpline(self.time, np.concatenate([self.gyro, self.acc], axis=1))

    def at(self, time: FloatArray, frame: float, order: int = 0) -> tuple[FloatArray, FloatArray]:
        """Return gyroscope and accelerometer (F, 3), or their derivatives, at times of the sensor's clock.

        Samples are averaged over frames that are longer than ``frame`` seconds per sample; NaN in gaps, where a channel
        is saturated, and beyond the ends.
        """
        if self.rate * frame > _AVERAGED:
            total = self._splines.antiderivative()
            both = (total(time + frame / 2, order) - total(time - frame / 2, order)) / frame
        else:
            both = self._splines(time, order)
        both[~self._covered(time)] = np.nan
        return both[:, :3], both[:, 3:]

    def _covered(self, time: FloatArray) -> BoolArray:
        after = np.searchsorted(self.time, time).clip(1, len(self.time) - 1)
        near = self.time[after] - self.time[after - 1] < _GAP / self.rate
        near &= (time >= self.time[0]) & (time <= self.time[-1])
        return np.asarray(near & ~self.saturated[after] & ~self.saturated[after - 1])
