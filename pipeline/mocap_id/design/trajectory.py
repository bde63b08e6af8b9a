"""A sampled movement: joint angles with derivatives, and the samples that an identification fits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import make_interp_spline

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.preparation import TrialData

_ROUNDING = 1e-9  # tolerance for rounding errors of a whole divisor of the rate
_DEGREE = 5  # degree of the splines: two more than the acceleration needs


@dataclass(frozen=True)
class Trajectory:
    """Joint angles and their derivatives, sample by sample."""

    time: FloatArray  # (T,) sample times with constant step, s
    # q, dq, ddq: (T, n) joint angles, rad, and their time derivatives; NaN where missing
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    # (T,) samples that an identification fits; None for all samples away from gaps and ends
    fitted: BoolArray | None = None

    @property
    def rate(self) -> float:
        """Samples per second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def seconds(self) -> float:
        """Duration, s."""
        return float(len(self.time) / self.rate)

    @property
    def known(self) -> BoolArray:
        """Mask (T,) of the samples with angle, velocity and acceleration of every joint."""
        return np.asarray(np.isfinite(np.hstack([self.q, self.dq, self.ddq])).all(axis=1))

    def thin(self, rate: float) -> Trajectory:
        """Return every k-th sample, with the largest k that leaves at least ``rate`` samples per second."""
        return self._select(slice(None, None, max(1, int(self.rate / rate + _ROUNDING))))

    def cut(self, seconds: float) -> Trajectory:
        """Return the first part of the movement, which lasts ``seconds``."""
        return self._select(slice(None, max(2, round(seconds * self.rate))))

    def _select(self, own: slice) -> Trajectory:
        """Return the selected samples as a trajectory."""
        fitted = None if self.fitted is None else self.fitted[own]
        return Trajectory(self.time[own], self.q[own], self.dq[own], self.ddq[own], fitted)

    def scale(self, speed: FloatArray, size: FloatArray) -> Trajectory:
        """Return the movement with the speed and the range of each joint multiplied by factors (n,).

        ``size`` multiplies the difference of each angle from its median. If the factors of speed differ, a joint moves
        forwards and backwards through its own recording. If they are equal, they change the duration instead.
        """
        time, length = self.time - self.time[0], float(self.time[-1] - self.time[0])
        if np.all(speed == speed[0]):
            time = time / speed[0]
        clock = np.multiply.outer(time, speed)
        forth = np.floor_divide(clock, length * (1 + 1e-12)) % 2 == 0
        clock = np.where(forth, clock, 2 * length - clock)
        return Trajectory(
            time,
            self._middle + size * (self._interpolate(self.q, clock) - self._middle),
            np.where(forth, 1.0, -1.0) * size * speed * self._interpolate(self.dq, clock),
            size * speed**2 * self._interpolate(self.ddq, clock),
            self.fitted,
        )

    @cached_property
    def _middle(self) -> FloatArray:
        """Median angles of the fitted samples (n,), rad."""
        return np.asarray(np.nanmedian(self.q if self.fitted is None else self.q[self.fitted], axis=0))

    def _interpolate(self, values: FloatArray, clock: FloatArray) -> FloatArray:
        """Interpolate the values (T, n) at times (R, n), given for each joint in seconds from the beginning."""
        stamped = self.time - self.time[0]
        return np.stack(
            [np.interp(own, stamped, column) for own, column in zip(clock.T, values.T, strict=True)], axis=1
        )


def get_recorded_trajectory(recorded: TrialData, fitted: BoolArray) -> Trajectory:
    """Return the recorded movement of a trial, with the samples (T,) that were fitted."""
    return Trajectory(recorded.time, recorded.q, recorded.dq, recorded.ddq, fitted)


def fit_trajectory(time: FloatArray, q: FloatArray) -> Trajectory:
    """Return the smooth movement through angles (T, n), rad, at times (T,) with constant step, s."""
    spline = make_interp_spline(time, q, k=_DEGREE)
    q, dq, ddq = (np.asarray(spline(time, order), dtype=np.float64) for order in range(3))
    return Trajectory(time, q, dq, ddq)


def concatenate(first: Trajectory, then: Trajectory) -> Trajectory:
    """Return two movements one after the other. Both must have ``fitted``, which must exclude the transition."""
    assert first.fitted is not None and then.fitted is not None
    time = np.concatenate([first.time, first.time[-1] + 1.0 / first.rate + then.time - then.time[0]])
    pairs = ((first.q, then.q), (first.dq, then.dq), (first.ddq, then.ddq))
    q, dq, ddq = (np.concatenate(pair) for pair in pairs)
    return Trajectory(time, q, dq, ddq, np.concatenate([first.fitted, then.fitted]))
