"""What a movement may ask of whoever makes it: angles, speeds, accelerations, and balance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.course import Course
from mocap_id.geometry import planar

_FIRM = 1e-9
_FASTER = 1.5  # than what was seen
_UPRIGHT = 0.9  # quantile of the highest joint's height
_INSIDE = 0.01  # m: so far inside the support lies the pressure of the posture at rest


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

    def inside(self, posture: FloatArray) -> FloatArray:
        """The allowed posture that is closest to one (n,), rad."""
        room = np.minimum(_FIRM, (self.high - self.low) / 2)
        return np.asarray(np.clip(posture, self.low + room, self.high - room))

    def strain(self, course: Course, wrench: FloatArray, moment_sd: FloatArray | None = None) -> float:
        """How much of what is allowed a movement takes: 1 is all of it, more is too much; infinite if it is unknown.

        Parameters
        ----------
        course : Course
            Where it has samples to fit, these are looked at.
        wrench : (T, 3) array
            Of the ground in it, N and N·m.
        moment_sd : (T,) array, optional
            How well its moment is foreseen, N·m: the centre of pressure has to stay inside by so much.
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
        if self.support is None:
            return worst
        sd = np.zeros(len(wrench)) if moment_sd is None else moment_sd
        return max(worst, _tilt(wrench[looked], sd[looked], self.support))


def _tilt(wrench: FloatArray, moment_sd: FloatArray, support: tuple[float, float]) -> float:
    """Largest distance of the centre of pressure from the middle of the support, by half its width."""
    if np.any(wrench[:, 1] <= 0.0):
        return np.inf
    low, high = support
    off = np.abs(wrench[:, 2] / wrench[:, 1] - (low + high) / 2) + moment_sd / wrench[:, 1]
    return float(np.max(off)) / max((high - low) / 2, _FIRM)


def observed_limits(
    course: Course,
    wrench: FloatArray,
    rest: FloatArray,
    *,
    widened: float,
    speed: tuple[float, float],
    acceleration: tuple[float, float],
    slack: float | None,
    at_rest: float,
) -> Limits:
    """Bounds from what was recorded.

    Parameters
    ----------
    course : Course
        The trial's movement, with the samples that were fitted.
    wrench : (T, 3) array
        Of the ground, N and N·m.
    rest : (n,) array
        Posture that is allowed in any case, rad.
    widened : float
        By which every joint may turn further than it was seen to at either end, rad.
    speed, acceleration : (float, float)
        Allowed in any case, and the most beyond what was seen, rad/s and rad/s²; between them 1.5 and 2.25 times what
        was seen.
    slack : float or None
        By which the centre of pressure may go beyond where it was seen, m; None for a base that is bolted down.
    at_rest : float
        Centre of pressure in the posture at rest, m.
    """
    known = course.known
    seen = (known if course.fitted is None else known & course.fitted) & (wrench[:, 1] > 0.0)
    pressure = wrench[seen, 2] / wrench[seen, 1]
    support = None
    if slack is not None:
        support = (
            float(min(pressure.min() - slack, at_rest - _INSIDE)),
            float(max(pressure.max() + slack, at_rest + _INSIDE)),
        )
    return Limits(
        low=np.minimum(course.q[known].min(axis=0) - widened, rest),
        high=np.maximum(course.q[known].max(axis=0) + widened, rest),
        speed=_allowed(course.dq[known], _FASTER, *speed),
        acceleration=_allowed(course.ddq[known], _FASTER**2, *acceleration),
        support=support,
    )


def _allowed(values: FloatArray, factor: float, least: float, most: float) -> FloatArray:
    """(n,) so many times the largest of values (T, n), at least and at most so much, but never less than was seen."""
    seen = np.abs(values).max(axis=0)
    return np.asarray(np.maximum(seen, np.clip(factor * seen, least, most)))


def resting_posture(course: Course, centres: FloatArray, upright: bool) -> FloatArray:
    """Posture to start from (n,), rad: the median one, for those who stand of the tenth in which they stand highest.

    Parameters
    ----------
    course : Course
        The trial's movement, with the samples that were fitted.
    centres : (n, 2) array
        Joint centres in the segment before, m.
    upright : bool
        Somebody stands.
    """
    q = course.q[course.known if course.fitted is None else course.known & course.fitted]
    if upright:
        height = planar.segment_poses(q, centres)[1][:, -1, 1]
        q = q[height >= np.quantile(height, _UPRIGHT)]
    return np.asarray(np.median(q, axis=0))
