"""Movements to choose from: every joint swings with a wave and its first overtone, or a person keeps the balance.

A person cannot swing three joints as a robot does. For those who have to balance, the first joint, the ankle, gives way
so that the centre of pressure of the posture is where it is asked to be: what is chosen there is how the person sways.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.course import Course, course_through
from mocap_id.dynamics.foresight import Body

LEAD, RAMP = 0.5, 1.5  # s: at rest at both ends, and over which the movement grows and fades


@dataclass(frozen=True)
class Waves:
    """A movement by a few numbers.

    Parameters
    ----------
    rest : (n,) array
        Angles at both ends, rad.
    centre : (n,) array
        Angles swung about, from those at rest, rad.
    frequency : (n,) array
        Of each joint's wave, Hz.
    amplitude, phase : (n, 2) arrays
        Of the wave and its first overtone, rad.
    balanced : bool
        The first row stands for the centre of pressure of the posture, m, and not for a joint.
    """

    rest: FloatArray
    centre: FloatArray
    frequency: FloatArray
    amplitude: FloatArray
    phase: FloatArray
    balanced: bool = False

    def sized(self, scale: float) -> Waves:
        """So much of it: swings and their centres."""
        return replace(self, centre=scale * self.centre, amplitude=scale * self.amplitude)

    def course(self, body: Body, seconds: float, rate: float) -> Course:
        """Sample by sample; NaN where no posture keeps the balance.

        Parameters
        ----------
        body : Body
        seconds, rate : float
            Length, s, and samples a second.
        """
        time = np.arange(round(seconds * rate)) / rate
        angle = 2 * np.pi * np.multiply.outer(time, self.frequency)  # (T, n)
        swing = sum(self.amplitude[:, k] * np.sin((k + 1) * angle + self.phase[:, k]) for k in range(2))
        moved = _envelope(time, seconds)[:, None] * (self.centre + swing)
        q = self.rest + moved
        if self.balanced:
            q[:, 0] = balancing(body, q, pressure(body, self.rest[None])[0] + moved[:, 0], self.rest[0])
        if not np.isfinite(q).all():
            return Course(time, q, q, q)
        return course_through(time, q)


def still(rest: FloatArray, balanced: bool = False) -> Waves:
    """No movement at all."""
    none = np.zeros((len(rest), 2))
    return Waves(rest, np.zeros(len(rest)), np.full(len(rest), 0.5), none, none, balanced)


def pressure(body: Body, q: FloatArray) -> FloatArray:
    """Centre of pressure (T,) of postures (T, n) at rest, m."""
    wrench = body.regressor(q, np.zeros_like(q), np.zeros_like(q)) @ body.found.base
    return np.asarray(wrench[:, 2] / wrench[:, 1])


def balancing(body: Body, q: FloatArray, target: FloatArray, near: float) -> FloatArray:
    """Angle of the first joint (T,), rad, that brings the posture's centre of pressure to a target.

    All that is above the first joint turns with it, so the centre of pressure is a constant and a sine of its angle.

    Parameters
    ----------
    body : Body
    q : (T, n) array
        Postures; the first joint's angle does not count.
    target : (T,) array
        m.
    near : float
        Of the two angles that do, the one closer to this is taken, rad.
    """
    ahead, across = q.copy(), q.copy()
    ahead[:, 0], across[:, 0] = 0.0, np.pi / 2
    at_zero, at_right = np.split(pressure(body, np.concatenate([ahead, across])), 2)
    opposite = q[:1].copy()
    opposite[:, 0] = np.pi
    constant = float((at_zero[0] + pressure(body, opposite)[0]) / 2)  # that of all that does not turn: of any posture
    cosine, sine = at_zero - constant, at_right - constant
    reach = (target - constant) / np.hypot(cosine, sine)
    with np.errstate(invalid="ignore"):  # beyond reach: no posture does it
        half = np.arccos(np.where(np.abs(reach) <= 1.0, reach, np.nan))
    both = np.arctan2(sine, cosine) + np.array([[1.0], [-1.0]]) * half
    off = (both - near + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(near + np.where(np.abs(off[0]) <= np.abs(off[1]), off[0], off[1]))


def _envelope(time: FloatArray, seconds: float) -> FloatArray:
    """0 for half a second at both ends, 1 between, with three continuous derivatives."""
    side = np.clip((np.minimum(time, time[-1] - time) - LEAD) / min(RAMP, seconds / 4), 0.0, 1.0)
    return np.asarray(side**4 * (35.0 - 84.0 * side + 70.0 * side**2 - 20.0 * side**3))
