"""What a movement may ask of whoever makes it: angles, speeds, accelerations, and balance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.course import Course

_FIRM = 1e-9


@dataclass(frozen=True)
class Limits:
    """Bounds of a movement.

    Parameters
    ----------
    low, high : (n,) arrays
        Joint angles, rad.
    speed, acceleration : (n,) arrays
        Of each joint, rad/s and rad/s².
    support : (float, float) or None
        Where the centre of pressure has to stay, m; None for a base that is bolted down.
    """

    low: FloatArray
    high: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    support: tuple[float, float] | None

    def strain(self, course: Course, wrench: FloatArray) -> float:
        """How much of what is allowed a movement takes: 1 is all of it, more is too much; infinite if it is unknown.

        Parameters
        ----------
        course : Course
            Where it has samples to fit, these are looked at.
        wrench : (T, 3) array
            Of the ground in it, N and N·m.
        """
        looked = course.known if course.fitted is None else course.fitted & course.known
        if not looked.any() or (course.fitted is None and not looked.all()):
            return np.inf
        middle, half = (self.low + self.high) / 2, np.maximum((self.high - self.low) / 2, _FIRM)
        parts = [
            np.abs(course.q[looked] - middle) / half,
            np.abs(course.dq[looked]) / self.speed,
            np.abs(course.ddq[looked]) / self.acceleration,
        ]
        worst = max(float(np.max(part)) for part in parts)
        return worst if self.support is None else max(worst, self._tilt(wrench[looked], self.support))

    @staticmethod
    def _tilt(wrench: FloatArray, support: tuple[float, float]) -> float:
        """Largest distance of the centre of pressure from the middle of the support, by half its width."""
        if np.any(wrench[:, 1] <= 0.0):
            return np.inf
        pressure = wrench[:, 2] / wrench[:, 1]
        low, high = support
        return float(np.max(np.abs(pressure - (low + high) / 2))) / max((high - low) / 2, _FIRM)
