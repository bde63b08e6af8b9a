"""Movements of sine waves: every joint swings with a wave and its first overtone.

A standing person has to keep balance and cannot swing three joints as a robot does. There, the angle of the first
joint, the ankle, follows from the wanted centre of pressure; the movement then describes how the person sways.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.design.predicted_covariance import IdentifiedBody
from mocap_id.design.trajectory import Trajectory, spline_trajectory

LEAD, RAMP = 0.5, 1.5  # s: rest at both ends, and time over which the movement grows and fades


@dataclass(frozen=True)
class WaveMovement:
    """Parameters of a wave movement of n joints.

    Parameters
    ----------
    rest : (n,) array
        Angles at both ends, rad.
    centre : (n,) array
        Centre of each swing relative to ``rest``, rad.
    frequency : (n,) array
        Frequency of each joint's wave, Hz.
    amplitude, phase : (n, 2) arrays
        Values of the wave and of its first overtone, rad.
    balanced : bool
        The first row describes the centre of pressure of the posture, m, and not a joint.
    """

    rest: FloatArray
    centre: FloatArray
    frequency: FloatArray
    amplitude: FloatArray
    phase: FloatArray
    balanced: bool = False

    def sized(self, scale: float) -> WaveMovement:
        """Return the movement with its swings and their centres multiplied by ``scale``."""
        return replace(self, centre=scale * self.centre, amplitude=scale * self.amplitude)

    def trajectory(self, body: IdentifiedBody, seconds: float, rate: float) -> Trajectory:
        """Sample the movement; all angles are NaN if a posture cannot keep the balance.

        Parameters
        ----------
        body : IdentifiedBody
        seconds, rate : float
            Duration, s, and samples per second.
        """
        time = np.arange(round(seconds * rate)) / rate
        angle = 2 * np.pi * np.multiply.outer(time, self.frequency)  # (T, n)
        swing = sum(self.amplitude[:, k] * np.sin((k + 1) * angle + self.phase[:, k]) for k in range(2))
        moved = _envelope(time, seconds)[:, None] * (self.centre + swing)
        q = self.rest + moved
        if self.balanced:
            q[:, 0] = balance(body, q, static_pressure(body, self.rest[None])[0] + moved[:, 0], self.rest[0])
        if not np.isfinite(q).all():
            return Trajectory(time, q, q, q)
        return spline_trajectory(time, q)


def rest_movement(rest: FloatArray, balanced: bool = False) -> WaveMovement:
    """Return a movement that stays in the posture ``rest`` (n,), rad."""
    none = np.zeros((len(rest), 2))
    return WaveMovement(rest, np.zeros(len(rest)), np.full(len(rest), 0.5), none, none, balanced)


def static_pressure(body: IdentifiedBody, q: FloatArray) -> FloatArray:
    """Return the centre of pressure (T,) of postures (T, n) at rest, m."""
    wrench = body.regressor(q, np.zeros_like(q), np.zeros_like(q)) @ body.found.base
    return np.asarray(wrench[:, 2] / wrench[:, 1])


def balance(body: IdentifiedBody, q: FloatArray, target: FloatArray, near: float) -> FloatArray:
    """Return the angle of the first joint (T,), rad, that moves the posture's centre of pressure to a target.

    Everything above the first joint turns with it, so the centre of pressure is a constant plus a sine of its angle.

    Parameters
    ----------
    body : IdentifiedBody
    q : (T, n) array
        Postures; the first joint's angle is not used.
    target : (T,) array
        m.
    near : float
        Of the two solutions, the one closer to this angle is taken, rad.
    """
    ahead, across = q.copy(), q.copy()
    ahead[:, 0], across[:, 0] = 0.0, np.pi / 2
    at_zero, at_right = np.split(static_pressure(body, np.concatenate([ahead, across])), 2)
    opposite = q[:1].copy()
    opposite[:, 0] = np.pi
    constant = float(
        (at_zero[0] + static_pressure(body, opposite)[0]) / 2
    )  # of what does not turn: any posture gives it
    cosine, sine = at_zero - constant, at_right - constant
    reach = (target - constant) / np.hypot(cosine, sine)
    with np.errstate(invalid="ignore"):  # NaN if no angle reaches the target
        half = np.arccos(np.where(np.abs(reach) <= 1.0, reach, np.nan))
    both = np.arctan2(sine, cosine) + np.array([[1.0], [-1.0]]) * half
    off = (both - near + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(near + np.where(np.abs(off[0]) <= np.abs(off[1]), off[0], off[1]))


def _envelope(time: FloatArray, seconds: float) -> FloatArray:
    """Return 0 for half a second at both ends and 1 between, with three continuous derivatives."""
    side = np.clip((np.minimum(time, time[-1] - time) - LEAD) / min(RAMP, seconds / 4), 0.0, 1.0)
    return np.asarray(side**4 * (35.0 - 84.0 * side + 70.0 * side**2 - 20.0 * side**3))
