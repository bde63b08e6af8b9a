"""Motions as smooth splines: what every joint does at any time, with exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.special import betainc

from mocap_id.arrays import FloatArray

STEP = 0.005  # s, between the samples that a motion's spline passes through
DEGREE = 7  # six continuous derivatives: the snap of every joint is smooth


def smoothstep(phase: FloatArray, order: int = 6) -> FloatArray:
    """0 below phase 0, 1 above phase 1, a polynomial with ``order - 1`` continuous derivatives between."""
    step: FloatArray = betainc(order, order, np.clip(phase, 0.0, 1.0))
    return step


@dataclass(frozen=True)
class Motion:
    """Joint angles as a function of time.

    Parameters
    ----------
    spline : BSpline
        (n,) joint angles, rad.
    duration : float
        The trial runs from 0 to here, s; the spline is defined somewhat beyond at both ends.
    """

    spline: BSpline
    duration: float

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Angle, velocity, acceleration and jerk, (T, n) each, at times (T,)."""
        q, dq, ddq, dddq = (np.asarray(self.spline(time, order), dtype=np.float64) for order in range(4))
        return q, dq, ddq, dddq


def through(time: FloatArray, angles: FloatArray, duration: float) -> Motion:
    """The motion whose spline passes through ``angles`` (T, n) at even times (T,)."""
    return Motion(make_interp_spline(time, angles, k=DEGREE), duration)


@dataclass(frozen=True)
class Swing:
    """A robot joint's motion.

    Parameters
    ----------
    frequency : float
        Hz.
    amplitude : float
        rad.
    centre : float
        Angle swung about, rad.
    periods : int
    lead : float
        Rest before and after, s.
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
        """Start and end of each period, s."""
        starts = self.lead + np.arange(self.periods) / self.frequency
        return [{"start": float(start), "end": float(start + 1 / self.frequency)} for start in starts]

    def motion(self) -> Motion:
        """Swings that begin and end at rest: the amplitude grows and fades over half a period."""
        time = np.arange(-1.0, self.duration + 1.0, STEP)
        phase = (time - self.lead) * self.frequency
        envelope = smoothstep(2 * phase) * smoothstep(2 * (self.periods - phase))
        angle = self.centre + self.amplitude * envelope * np.sin(2 * np.pi * phase)
        return through(time, angle[:, None], self.duration)
