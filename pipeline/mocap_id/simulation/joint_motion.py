"""Joint motions as smooth splines with exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.special import betainc

from mocap_id.arrays import FloatArray

STEP = 0.005  # s, between the samples of a motion's spline
DEGREE = 7  # six continuous derivatives: the snap of every joint is smooth


def smoothstep(phase: FloatArray, order: int = 6) -> FloatArray:
    """Return 0 below phase 0, 1 above phase 1, and between them a polynomial with ``order - 1`` smooth derivatives."""
    step: FloatArray = betainc(order, order, np.clip(phase, 0.0, 1.0))
    return step


@dataclass(frozen=True)
class JointMotion:
    """Joint angles as a function of time.

    Parameters
    ----------
    spline : BSpline
        (n,) joint angles, rad.
    duration : float
        End of the trial, s; it starts at 0. The spline extends somewhat beyond both ends.
    """

    spline: BSpline
    duration: float

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return angle, velocity, acceleration and jerk, (T, n) each, at times (T,)."""
        q, dq, ddq, dddq = (np.asarray(self.spline(time, order), dtype=np.float64) for order in range(4))
        return q, dq, ddq, dddq


def motion_through(time: FloatArray, angles: FloatArray, duration: float) -> JointMotion:
    """Return the motion whose spline passes through ``angles`` (T, n) at evenly spaced times (T,)."""
    return JointMotion(make_interp_spline(time, angles, k=DEGREE), duration)


@dataclass(frozen=True)
class Swing:
    """Sinusoidal motion of a robot's joint.

    Parameters
    ----------
    frequency : float
        Hz.
    amplitude : float
        rad.
    centre : float
        Mean angle, rad.
    periods : int
    lead : float
        Rest before and after the motion, s.
    """

    frequency: float
    amplitude: float
    centre: float
    periods: int
    lead: float

    @property
    def duration(self) -> float:
        return self.periods / self.frequency + 2 * self.lead

    def repetitions(self) -> list[dict[str, Any]]:
        """Return start and end of each period, s."""
        starts = self.lead + np.arange(self.periods) / self.frequency
        return [{"start": float(start), "end": float(start + 1 / self.frequency)} for start in starts]

    def motion(self) -> JointMotion:
        """Return the motion; it begins and ends at rest, with half a period of growing and fading amplitude."""
        time = np.arange(-1.0, self.duration + 1.0, STEP)
        phase = (time - self.lead) * self.frequency
        envelope = smoothstep(2 * phase) * smoothstep(2 * (self.periods - phase))
        angle = self.centre + self.amplitude * envelope * np.sin(2 * np.pi * phase)
        return motion_through(time, angle[:, None], self.duration)
