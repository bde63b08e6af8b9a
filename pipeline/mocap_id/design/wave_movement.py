"""Movements of sine waves: every joint swings with a wave and its first overtone.

A standing person has to keep balance and cannot swing three joints as a robot does. The movement of a person therefore
describes the sway of the centre of pressure, and the angle of the first joint, the ankle, follows from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.design.predicted_covariance import IdentifiedBody
from mocap_id.design.trajectory import Trajectory, fit_trajectory

_LEAST_SWING = np.radians(0.5)  # smaller swings are not mentioned
_LEAST_SWAY = 0.0025  # m: smaller sways are not mentioned
LEAD, RAMP = 0.5, 1.5  # s: rest at both ends, and time over which the movement grows and fades


@dataclass(frozen=True)
class WaveMovement:
    """Parameters of a wave movement of n joints."""

    rest: FloatArray  # (n,) angles at both ends, rad
    centre: FloatArray  # (n,) centre of each swing relative to `rest`, rad
    frequency: FloatArray  # (n,) frequency of each joint's wave, Hz
    # amplitude, phase: (n, 2) amplitude and phase of the wave and of its first overtone, rad
    amplitude: FloatArray
    phase: FloatArray
    # whether the first row is the centre of pressure, m, instead of the angle of the first joint
    balanced: bool = False

    def scale(self, scale: float) -> WaveMovement:
        """Return the movement with its amplitudes and its centres multiplied by ``scale``."""
        return replace(self, centre=scale * self.centre, amplitude=scale * self.amplitude)

    def trajectory(self, body: IdentifiedBody, seconds: float, rate: float) -> Trajectory:
        """Return the movement of a body, sampled for a duration (s) at a rate.

        The angle of the first joint is NaN in samples in which it cannot keep the balance. No derivative is valid then.
        """
        time = np.arange(round(seconds * rate)) / rate
        angle = 2 * np.pi * np.multiply.outer(time, self.frequency)  # (T, n)
        swing = sum(self.amplitude[:, k] * np.sin((k + 1) * angle + self.phase[:, k]) for k in range(2))
        moved = _compute_envelope(time, seconds)[:, None] * (self.centre + swing)
        q = self.rest + moved
        if self.balanced:
            q[:, 0] = balance(body, q, static_centre_of_pressure(body, self.rest[None])[0] + moved[:, 0], self.rest[0])
        if not np.isfinite(q).all():
            return Trajectory(time, q, q, q)
        return fit_trajectory(time, q)


def hold_posture(rest: FloatArray, balanced: bool = False) -> WaveMovement:
    """Return a movement that stays in the posture ``rest`` (n,), rad."""
    none = np.zeros((len(rest), 2))
    return WaveMovement(rest, np.zeros(len(rest)), np.full(len(rest), 0.5), none, none, balanced)


def static_centre_of_pressure(body: IdentifiedBody, q: FloatArray) -> FloatArray:
    """Return the centre of pressure (T,), m, of a body at rest in postures (T, n), rad."""
    wrench = body.regressor(q, np.zeros_like(q), np.zeros_like(q)) @ body.result.base
    return np.asarray(wrench[:, 2] / wrench[:, 1])


def balance(body: IdentifiedBody, q: FloatArray, target: FloatArray, near: float) -> FloatArray:
    """Return the angles (T,) of the first joint, rad, with which a body at rest has the centre of pressure ``target``.

    All segments above the first joint rotate with it, so the centre of pressure is a constant plus a sine of its angle.
    The postures ``q`` (T, n) give the other angles. Of the two solutions, the one closer to the angle ``near``, rad, is
    returned. It is NaN if no angle gives the ``target`` (T,), m.
    """
    ahead, across = q.copy(), q.copy()
    ahead[:, 0], across[:, 0] = 0.0, np.pi / 2
    at_zero, at_right = np.split(static_centre_of_pressure(body, np.concatenate([ahead, across])), 2)
    opposite = q[:1].copy()
    opposite[:, 0] = np.pi
    # the part of the base, which does not rotate, is the same in every posture
    constant = float((at_zero[0] + static_centre_of_pressure(body, opposite)[0]) / 2)
    cosine, sine = at_zero - constant, at_right - constant
    reach = (target - constant) / np.hypot(cosine, sine)
    with np.errstate(invalid="ignore"):  # NaN if no angle reaches the target
        half = np.arccos(np.where(np.abs(reach) <= 1.0, reach, np.nan))
    both = np.arctan2(sine, cosine) + np.array([[1.0], [-1.0]]) * half
    off = (both - near + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(near + np.where(np.abs(off[0]) <= np.abs(off[1]), off[0], off[1]))


def _compute_envelope(time: FloatArray, seconds: float) -> FloatArray:
    """Return weights (T,) that rise from 0 at both ends to 1, with three continuous derivatives."""
    side = np.clip((np.minimum(time, time[-1] - time) - LEAD) / min(RAMP, seconds / 4), 0.0, 1.0)
    return np.asarray(side**4 * (35.0 - 84.0 * side + 70.0 * side**2 - 20.0 * side**3))


def describe_waves(waves: WaveMovement, joints: Sequence[str]) -> str:
    """Return the movement as instructions, one phrase for each of the named joints."""
    phrases = [_describe_joint(waves, j, joints[j]) for j in range(int(waves.balanced), len(joints))]
    text = "; ".join(phrase for phrase in phrases if phrase)
    if not waves.balanced:
        return text
    sway = float(waves.amplitude[0, 0])
    keeping = f"let {add_article(joints[0])} keep the balance"
    if abs(sway) < _LEAST_SWAY:
        return f"{text}; {keeping}"
    swaying = f"sway to and fro by {100 * abs(sway):.1f} cm at {waves.frequency[0]:.2f} Hz"
    return "; ".join(part for part in (text, f"{swaying} and {keeping}") if part)


def _describe_joint(waves: WaveMovement, joint: int, name: str) -> str:
    """Return the phrase for one joint; an empty string if the joint hardly moves."""
    size = float(np.hypot(*waves.amplitude[joint]))
    if size < _LEAST_SWING:
        if abs(waves.centre[joint]) < _LEAST_SWING:
            return ""
        return f"hold {add_article(name)} at {_format_degrees(waves.rest[joint] + waves.centre[joint])}"
    middle, first = waves.rest[joint] + waves.centre[joint], abs(float(waves.amplitude[joint, 0]))
    overtone = abs(float(waves.amplitude[joint, 1]))
    ends = f"from {_format_degrees(middle - first)} to {_format_degrees(middle + first)}"
    second = f", and {_format_degrees(overtone)} at twice this frequency" if overtone >= _LEAST_SWING else ""
    return f"swing {add_article(name)} by ±{_format_degrees(first)} ({ends}) at {waves.frequency[joint]:.2f} Hz{second}"


def add_article(name: str) -> str:
    """Return a joint's name as used within a sentence: ``the hip``, but ``joint 2``."""
    return name if name[-1:].isdigit() else f"the {name}"


def _format_degrees(angle: float) -> str:
    return f"{round(float(np.degrees(angle))):d}°"
