"""One joint under gravity with a spring, and the angles that a person can hold (eq. 7.8).

The torque that holds the joint at rest is τ_H = g(θ) + k(θ - θ₀) with g(θ) = a sin θ + b cos θ. For an arm that hangs
down at θ = 0, a = mgl and b = 0. A person can hold the angles at which τ_H is within the limits of the torque.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry.planar import rotate, segment_poses

_SLACK = 1e-8  # tolerance of the limits, as a fraction of the size of the torque


@dataclass(frozen=True)
class OneJoint:
    """A joint under gravity, with limits of its angle and of the person's torque.

    ValueError is raised if a lower limit is not below the upper one, or the gravitational moment is zero.
    """

    sine: float  # a, N·m; mgl of eq. 7.7
    cosine: float  # b, N·m
    lower: float  # limits of the angle, rad
    upper: float
    torque_low: float  # limits of the person's torque, N·m; extension is negative
    torque_high: float

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ValueError(
                f"the limits of the angle are crossed: {np.degrees(self.lower):.1f}° is not below "
                f"{np.degrees(self.upper):.1f}°"
            )
        if not self.torque_low < self.torque_high:
            raise ValueError(
                f"the limits of the torque are crossed: {self.torque_low:g} N·m is not below {self.torque_high:g} N·m"
            )
        if not 0 < self.weight < np.inf:
            raise ValueError("the gravitational moment is zero or not finite; expected mass and lever arm above zero")

    @property
    def weight(self) -> float:
        """Largest gravitational moment, N·m: mgl."""
        return float(np.hypot(self.sine, self.cosine))

    def gravity(self, angle: FloatArray) -> FloatArray:
        """Return the gravitational moment g(θ), N·m, at angles, rad."""
        return np.asarray(self.sine * np.sin(angle) + self.cosine * np.cos(angle))

    def torque(self, angle: FloatArray, stiffness: float, rest: float) -> FloatArray:
        """Return the torque that holds the joint at rest, N·m (eq. 7.8)."""
        return self.gravity(angle) + stiffness * (np.asarray(angle) - rest)

    def turning_points(self, stiffness: float) -> FloatArray:
        """Return the angles within the limits at which the torque has an extremum, rad (eq. 7.9, corrected).

        With a sin θ + b cos θ = mgl sin(θ + φ), these angles satisfy cos(θ + φ) = -k/mgl. For k > mgl there are none.
        """
        share = -stiffness / self.weight
        if share < -1:
            return np.zeros(0)
        phase, half = np.arctan2(self.cosine, self.sine), np.arccos(share)
        angles = []
        for base in (half - phase, -half - phase):
            first = ceil((self.lower - base) / (2 * np.pi))
            last = floor((self.upper - base) / (2 * np.pi))
            angles += [base + 2 * np.pi * turn for turn in range(first, last + 1)]
        return np.unique(angles)

    def held_intervals(self, stiffness: float, rest: float) -> list[tuple[float, float]]:
        """Return the intervals of angles that a person with this spring can hold, in ascending order, rad."""
        slack = _SLACK * (self.torque_high - self.torque_low + self.weight)
        knots = np.unique(np.concatenate([[self.lower, self.upper], self.turning_points(stiffness)]))
        intervals: list[tuple[float, float]] = []
        for start, end in itertools.pairwise(knots):  # the torque is monotone in between
            part = self._held_part(float(start), float(end), stiffness, rest, slack)
            if part is None:
                continue
            if intervals and part[0] <= intervals[-1][1]:
                intervals[-1] = (intervals[-1][0], part[1])
            else:
                intervals.append(part)
        return intervals

    def widest_interval(
        self, stiffness: float, rest: float, required: Sequence[float] = ()
    ) -> tuple[float, float] | None:
        """Return the widest of the held intervals that contain all required angles, rad; None if there is none."""
        tolerance = 1e-6
        fitting = [
            part
            for part in self.held_intervals(stiffness, rest)
            if all(part[0] - tolerance <= angle <= part[1] + tolerance for angle in required)
        ]
        return max(fitting, key=lambda part: part[1] - part[0], default=None)

    def _held_part(
        self, start: float, end: float, stiffness: float, rest: float, slack: float
    ) -> tuple[float, float] | None:
        """Return the part that can be held of an interval with monotone torque; None if no part can be held."""
        at_start, at_end = self.torque(np.array([start, end]), stiffness, rest).tolist()
        low, high = self.torque_low - slack, self.torque_high + slack
        if max(at_start, at_end) < low or min(at_start, at_end) > high:
            return None

        def find_end(here: float, there: float, value: float) -> float:
            if low <= value <= high:
                return here
            return self._crossing(here, there, low if value < low else high, stiffness, rest)

        return find_end(start, end, at_start), find_end(end, start, at_end)

    def _crossing(self, here: float, there: float, level: float, stiffness: float, rest: float) -> float:
        """Return the angle between two angles at which the torque crosses a level, by bisection down to rounding."""
        sign = self.torque(np.array(here), stiffness, rest) > level
        for _ in range(60):
            middle = 0.5 * (here + there)
            if (self.torque(np.array(middle), stiffness, rest) > level) == sign:
                here = middle
            else:
                there = middle
        return there


@dataclass(frozen=True)
class ChainMasses:
    """Masses of a planar chain; ValueError is raised if a mass is not finite, or if all masses are zero."""

    centres: FloatArray  # (n, 2) centre of each joint in the frame of the previous segment, m
    # (n, 3) m, mx, my of each moving segment in its own frame, kg and kg·m. Identified parameters are sufficient:
    # only the combinations that they determine affect the torques.
    masses: FloatArray
    gravity: float = 9.81  # m/s², along -y

    def __post_init__(self) -> None:
        if not np.isfinite(self.masses).all():
            raise ValueError("a mass is not finite; expected finite masses and first moments of all segments")
        if not self.masses.any():
            raise ValueError("all masses are zero; expected at least one segment with a mass")

    def torques(self, q: FloatArray) -> FloatArray:
        """Return the joint torques (..., n), N·m, that hold postures (..., n), rad, against gravity.

        A torque is the moment g Σ (m (x - x_joint) + mx cos α - my sin α) of the segments distal to the joint, whose
        angles are α.
        """
        angle, origin = segment_poses(q, self.centres)
        lever = rotate(angle[..., 1:], self.masses[:, 1:])[..., 0]  # (..., n)
        mass = self.masses[:, 0]
        x = origin[..., 1:, 0]
        moment = np.cumsum((mass * x + lever)[..., ::-1], axis=-1)[..., ::-1]
        beyond = np.cumsum(mass[::-1])[::-1]
        return np.asarray(self.gravity * (moment - beyond * x))

    def one_joint(
        self, joint: int, posture: FloatArray, limits: tuple[float, float], torque: tuple[float, float]
    ) -> OneJoint:
        """Return the model of one joint, counted from 0, while the other joints are fixed at ``posture`` (n,), rad.

        ValueError is raised as for :class:`OneJoint`.
        """
        postures = np.tile(posture, (2, 1)).astype(np.float64)
        postures[:, joint] = 0.0, np.pi / 2
        cosine, sine = self.torques(postures)[:, joint].tolist()
        return OneJoint(sine, cosine, *limits, *torque)
