"""Clock of an inertial sensor relative to the cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.estimation.inertial.signals import SegmentMotion, SensorSignals

OBSERVABLE_SD = 2e-3  # largest standard deviation, s, of a clock that the motion determines

_LEAST_OVERLAP = 0.5  # of the shorter record
_BORROWED_SD = 0.1  # s, least standard deviation of a clock taken from other sensors


@dataclass(frozen=True)
class Clock:
    """Clock of a sensor: a sample stamped t was taken at the cameras' time ``offset + t (1 + drift)``."""

    offset: float  # s
    drift: float = 0.0  # s/s
    sd: float = np.inf  # standard deviation in the middle of the trial, s
    observable: bool = False  # the motion determines the clock; otherwise it is another sensor's clock, or zero

    def stamps(self, time: FloatArray) -> FloatArray:
        """Return the sensor's time stamps at times of the cameras, s."""
        return np.asarray((time - self.offset) / (1.0 + self.drift))


def find_clock(signals: SensorSignals, motion: SegmentMotion, time: FloatArray) -> tuple[float, float]:
    """Return the clock offset, s, at which angular speeds of sensor and segment correlate best, and the correlation.

    ``time`` (F,) are uniform times of the cameras, s. Both are zero if the motion is known in no frame.
    """
    step = float(time[1] - time[0])
    known = motion.known
    if not known.any():
        return 0.0, 0.0
    speed = np.linalg.norm(motion.omega, axis=1)
    first = np.where(known, speed - speed[known].mean(), 0.0)
    stamps = np.arange(signals.time[0], signals.time[-1], step)
    gyro = np.linalg.norm(signals.gyro - np.median(signals.gyro, axis=0), axis=1)
    second = np.interp(stamps, signals.time, gyro)
    second -= second.mean()
    size = 1 << int(np.ceil(np.log2(len(first) + len(second))))

    def shifted(a: FloatArray, b: FloatArray) -> FloatArray:
        """Return the sums over k of a[k + lag] b[k] for lags from 1 - len(b)."""
        product = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        return np.concatenate([product[size - len(b) + 1 :], product[: len(a)]])

    there, all_there = known.astype(np.float64), np.ones(len(second))
    count = shifted(there, all_there)
    power = shifted(first**2, all_there) * shifted(there, second**2)
    enough = count > _LEAST_OVERLAP * min(known.sum(), len(second))
    correlation = np.where(enough & (power > 0), shifted(first, second) / np.sqrt(np.maximum(power, 1e-30)), -1.0)
    best = int(np.argmax(correlation))
    return float(time[0] - stamps[0] + (best + 1 - len(second)) * step), float(correlation[best])


def borrow_clock(others: Sequence[Clock]) -> Clock:
    """Return the median offset of the other sensors' clocks, for a sensor whose motion does not determine its clock.

    Without other sensors, the offset is zero and its standard deviation infinite.
    """
    if not others:
        return Clock(0.0, sd=np.inf)
    offsets = np.array([each.offset for each in others])
    spread = float(np.std(offsets, ddof=1)) if len(offsets) > 1 else 0.0
    return Clock(float(np.median(offsets)), 0.0, max(spread, _BORROWED_SD), False)
