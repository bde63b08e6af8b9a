"""A movement as an identification sees it: joint angles and derivatives at even times, and which samples count."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.prepare import Recorded

_EXACTLY = 1e-9  # a whole part of the rate, in spite of rounding
_DEGREE = 5  # of the splines behind derivatives: two more than the acceleration needs


@dataclass(frozen=True)
class Course:
    """A movement, sample by sample.

    Parameters
    ----------
    time : (T,) array
        s, even steps.
    q, dq, ddq : (T, n) arrays
        Joint angles and derivatives, rad; NaN where unknown.
    fitted : (T,) bool array or None
        Samples that an identification uses; None for all that its filter leaves.
    """

    time: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    fitted: BoolArray | None = None

    @property
    def rate(self) -> float:
        """Samples a second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def seconds(self) -> float:
        """How long it lasts, s."""
        return float(len(self.time) / self.rate)

    @property
    def known(self) -> BoolArray:
        """Samples (T,) whose state is known."""
        return np.asarray(np.isfinite(np.hstack([self.q, self.dq, self.ddq])).all(axis=1))

    def thinned(self, rate: float) -> Course:
        """Every so-many-th sample, so that ``rate`` a second or somewhat more are left."""
        return self._part(slice(None, None, max(1, int(self.rate / rate + _EXACTLY))))

    def until(self, seconds: float) -> Course:
        """The beginning of it."""
        return self._part(slice(None, max(2, round(seconds * self.rate))))

    def _part(self, own: slice) -> Course:
        fitted = None if self.fitted is None else self.fitted[own]
        return Course(self.time[own], self.q[own], self.dq[own], self.ddq[own], fitted)

    def scaled(self, speed: FloatArray, size: FloatArray) -> Course:
        """The same movement with each joint at its own speed and size (n,), about its median angle.

        A joint that is faster than the others runs to and fro over its own recording; all together they pass through
        the same postures.
        """
        middle = np.nanmedian(self.q if self.fitted is None else self.q[self.fitted], axis=0)
        time, length = self.time - self.time[0], float(self.time[-1] - self.time[0])
        if np.all(speed == speed[0]):
            time = time / speed[0]
        clock = np.multiply.outer(time, speed)
        forth = np.floor_divide(clock, length * (1 + 1e-12)) % 2 == 0
        clock = np.where(forth, clock, 2 * length - clock)
        return Course(
            time,
            middle + size * (self._at(self.q, clock) - middle),
            np.where(forth, 1.0, -1.0) * size * speed * self._at(self.dq, clock),
            size * speed**2 * self._at(self.ddq, clock),
            self.fitted,
        )

    def _at(self, values: FloatArray, clock: FloatArray) -> FloatArray:
        """Series (T, n) at every joint's own times (R, n) from the beginning, s."""
        stamped = self.time - self.time[0]
        return np.stack(
            [np.interp(own, stamped, column) for own, column in zip(clock.T, values.T, strict=True)], axis=1
        )


def recorded_course(recorded: Recorded, fitted: BoolArray) -> Course:
    """The movement that was recorded, of which these samples (T,) were fitted."""
    return Course(recorded.time, recorded.q, recorded.dq, recorded.ddq, fitted)


def course_through(time: FloatArray, q: FloatArray) -> Course:
    """The smooth movement through angles (T, n), rad, at even times (T,), s."""
    spline = make_interp_spline(time, q, k=_DEGREE)
    q, dq, ddq = (np.asarray(spline(time, order), dtype=np.float64) for order in range(3))
    return Course(time, q, dq, ddq)


def joined(first: Course, then: Course) -> Course:
    """One movement after the other, both with their own samples; at the joint between them none may count."""
    assert first.fitted is not None and then.fitted is not None
    time = np.concatenate([first.time, first.time[-1] + 1.0 / first.rate + then.time - then.time[0]])
    pairs = ((first.q, then.q), (first.dq, then.dq), (first.ddq, then.ddq))
    q, dq, ddq = (np.concatenate(pair) for pair in pairs)
    return Course(time, q, dq, ddq, np.concatenate([first.fitted, then.fitted]))
