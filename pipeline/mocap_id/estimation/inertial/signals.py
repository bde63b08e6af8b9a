"""Signals of an inertial sensor, and the motion of the segment on which it is worn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.verdict import Reason

GRAVITY = 9.81  # gravity, m/s²; in the trial's axes, it acts along -y

_GAP = 2.5  # times the usual time between samples; a longer time is a gap
_AVERAGED = 1.5  # samples in a frame; if there are more, they are averaged
_PINNED = 3  # number of successive samples at the largest value of a channel from which they are saturated


@dataclass(frozen=True)
class MotionFromMarkers:
    """Motion of a segment at F frames, in its own axes; NaN where unknown."""

    omega: FloatArray  # (F, 3) angular velocity, rad/s
    alpha: FloatArray  # (F, 3) angular acceleration, rad/s²
    force: FloatArray  # (F, 3) acceleration of the origin minus gravity, m/s²
    axial: FloatArray  # (F,) axial rotation relative to the parent, rad; zero for the base
    axial_rate: FloatArray  # (F,) its rate, rad/s
    long_axis: FloatArray  # (3,) unit vector of the axial rotation

    @property
    def known(self) -> BoolArray:
        """Whether (F,) the motion is known in a frame."""
        return np.asarray(np.isfinite(self.omega[:, 0] + self.alpha[:, 0] + self.force[:, 0] + self.axial_rate))

    def select(self, frames: IntArray) -> MotionFromMarkers:
        """Return the motion in the chosen frames."""
        names = ("omega", "alpha", "force", "axial", "axial_rate")
        return replace(self, **{name: getattr(self, name)[frames] for name in names})


@dataclass(frozen=True)
class SensorSignals:
    """K samples of a sensor on its own clock."""

    time: FloatArray  # (K,) increasing times, s
    gyro: FloatArray  # (K, 3) angular velocity in the sensor's axes, rad/s
    acc: FloatArray  # (K, 3) specific force in the sensor's axes, m/s²
    reasons: tuple[Reason, ...] = ()  # about samples that the reader left out

    @cached_property
    def rate(self) -> float:
        """Samples per second."""
        return float(1.0 / np.median(np.diff(self.time)))

    @cached_property
    def saturated(self) -> BoolArray:
        """Whether each sample (K,) is in a run of samples in which a channel stays at its largest or smallest value."""
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
        """Standard deviations (2,) of the white noise of one sample: gyroscope, rad/s, and accelerometer, m/s²."""
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
        """Return gyroscope (F, 3) and accelerometer (F, 3) at times (F,) of the sensor's clock, s.

        ``order`` is the order of the derivative that is returned. If a frame, which takes ``frame`` seconds, contains
        several samples, they are averaged. The result is NaN in gaps, at saturated samples, and beyond the ends.
        """
        if self.rate * frame > _AVERAGED:
            total = self._splines.antiderivative()
            both = (total(time + frame / 2, order) - total(time - frame / 2, order)) / frame
        else:
            both = self._splines(time, order)
        after = np.searchsorted(self.time, time).clip(1, len(self.time) - 1)
        covered = self.time[after] - self.time[after - 1] < _GAP / self.rate
        covered &= (time >= self.time[0]) & (time <= self.time[-1])
        covered &= ~self.saturated[after] & ~self.saturated[after - 1]
        both[~covered] = np.nan
        return both[:, :3], both[:, 3:]
