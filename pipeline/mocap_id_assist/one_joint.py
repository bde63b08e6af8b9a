"""One joint under gravity: the angles that a person can hold, and the spring that widens their range.

The torque that holds the joint at rest is τ_H = g(θ) + k(θ - θ₀) with g(θ) = a sin θ + b cos θ (eq. 7.8). For an arm
that hangs down at θ = 0, a = mgl and b = 0. A person can hold the angles at which τ_H is within the limits of the
torque.

The best spring (eq. 7.10, 7.11) is found by a global search. With w(θ) = g(θ) + kθ, an angle can be held if w - kθ₀ is
within the limits of the torque. Two conditions must be met for an interval: w varies in it by at most the distance of
the limits, and an allowed rest angle shifts it between them. For one stiffness, a single pass over a grid of angles
finds the widest such interval for all rest angles (:mod:`mocap_id_assist.holding_kernels`). The stiffness is searched
by branch and bound. If the stiffness changes by up to h, the torques change by at most h times the largest distance
from a rest angle. Limits widened by this amount give an upper bound for all these stiffnesses. Sequential quadratic
programming (eq. 7.9) refines the best spring. The reported range can be held exactly.

The softest spring for an interval of angles (thesis 9.6): the limits of the torque are τ_low and τ_high, those of the
rest angle θ_least and θ_most. A rest angle exists for a stiffness k if w meets three inequalities: max w - min w ≤
τ_high - τ_low, max w - τ_high ≤ k θ_most and min w - τ_low ≥ k θ_least. Each involves a maximum or minimum of functions
that are linear in k, and is convex in k. The suitable stiffnesses therefore form an interval, and bisection finds its
lower end.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor
from typing import Any

import numpy as np
from scipy.optimize import Bounds, minimize

from mocap_id.arrays import FloatArray
from mocap_id_assist.holding_kernels import find_widest_runs

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
        low, high = self.torque_low - slack, self.torque_high + slack

        def find_end(here: float, there: float, value: float) -> float:
            """Return the first angle from ``here``, with torque ``value``, to ``there`` that can be held."""
            if low <= value <= high:
                return here
            level = low if value < low else high
            sign = self.torque(np.array(here), stiffness, rest) > level
            for _ in range(60):  # by bisection down to rounding
                middle = 0.5 * (here + there)
                if (self.torque(np.array(middle), stiffness, rest) > level) == sign:
                    here = middle
                else:
                    there = middle
            return there

        knots = np.unique(np.concatenate([[self.lower, self.upper], self.turning_points(stiffness)])).tolist()
        intervals: list[tuple[float, float]] = []
        for start, end in itertools.pairwise(knots):  # the torque is monotone in between
            at_start, at_end = self.torque(np.array([start, end]), stiffness, rest).tolist()
            if max(at_start, at_end) < low or min(at_start, at_end) > high:
                continue
            part = find_end(start, end, at_start), find_end(end, start, at_end)
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


REST = (-2 * np.pi, 2 * np.pi)
"""Allowed rest angles, rad (eq. 7.10)."""


PENALTY = 1e-4
"""δ of eq. 7.10: gain of range, rad, that justifies a stiffness of mgl per radian (several joints: gain of area)."""


_HELPS = np.radians(0.5)  # least gain of range for which a spring is prescribed
_TOLERANCE = np.radians(0.2)
_COARSE, _FINE, _LEVELS, _REFINED_FROM = 512, 4096, 16, 3  # angles of the grids; levels of the search


@dataclass(frozen=True)
class Prescription:
    """A spring prescribed for one joint."""

    stiffness: float  # N·m/rad; 0 for no spring
    rest: float  # θ₀, rad; NaN for no spring
    range: tuple[float, float]  # range that can be held with the spring, rad
    without: tuple[float, float] | None  # widest range that can be held without it, rad; None if there is none
    gap: float  # upper bound of the further gain in range minus penalty by any other spring, rad
    helps: bool  # whether the spring gives a relevant gain


def prescribe_spring(
    joint: OneJoint,
    required: tuple[float, ...] = (),
    rest: tuple[float, float] = REST,
    stiffest: float | None = None,
    penalty: float = PENALTY,
) -> Prescription:
    """Return the spring with which a person can hold the largest range of a joint.

    The range must contain the ``required`` angles, rad (eq. 7.11). ``rest`` has the smallest and largest rest angle,
    rad. ``stiffest`` is the largest stiffness, N·m/rad; 0 for no spring, None for all stiffnesses that could help.
    ``penalty`` is δ, the penalty for a stiffness of mgl per radian, rad.

    ValueError is raised if a required angle is outside the joint's limits, or the person cannot hold all of them with
    any spring.
    """
    for angle in required:
        if not joint.lower <= angle <= joint.upper:
            raise ValueError(
                f"the required angle {np.degrees(angle):.1f}° is outside the joint's limits, "
                f"{np.degrees(joint.lower):.1f}° to {np.degrees(joint.upper):.1f}°"
            )
    without = joint.widest_interval(0.0, 0.0, required)
    none = -np.inf if without is None else without[1] - without[0]
    best, worth, bound = None, none, none
    if stiffest != 0:
        best, worth, bound = _search(joint, required, rest, stiffest, penalty, none)
    free = joint.widest_interval(0.0, 0.0)
    if without is not None and (best is None or worth <= none + _HELPS):
        return Prescription(0.0, np.nan, without, free, max(bound - none, 0.0), False)
    if best is None:
        raise ValueError("no spring lets the person hold all required angles and the angles between them")
    held = joint.widest_interval(*best, required)
    assert held is not None
    return Prescription(*best, held, free, max(bound - worth, 0.0), True)


def _search(  # noqa: PLR0917
    joint: OneJoint,
    required: tuple[float, ...],
    rest: tuple[float, float],
    given: float | None,
    penalty: float,
    none: float,
) -> tuple[tuple[float, float] | None, float, float]:
    """Return stiffness and rest angle of the best spring, its range minus penalty, and an upper bound of the latter.

    ``none`` is the range without a spring, and ``given`` the largest stiffness or None.
    """
    stiffest, most_refined = given, np.inf if given is None else given
    if stiffest is None:
        # above this stiffness, no range exceeds five degrees and the range without a spring: over a range R, a spring
        # changes the torque by kR, and gravity compensates at most 2mgl of this
        least = max(none, np.ptp(required) if required else 0.0, np.radians(5.0))
        stiffest = float((joint.torque_high - joint.torque_low + 2 * joint.weight) / least)
    half = 0.5 * stiffest
    centres, worth, bound = np.array([half]), none, np.inf
    best: tuple[float, float] | None = None
    limits, rests = np.array([joint.torque_low, joint.torque_high]), np.array(rest)
    pruned = none
    for level in range(_LEVELS):
        # the grid of angles, and the indices of the first and last required angle
        grid = np.linspace(joint.lower, joint.upper, min(_FINE, _COARSE << level // 2))
        first, last = 1, 0
        if required:
            inner = np.flatnonzero((grid >= min(required)) & (grid <= max(required)))
            inner = inner if len(inner) else np.abs(grid - required[0]).argmin(axis=0, keepdims=True)
            first, last = int(inner[0]), int(inner[-1])
        step, gravity = float(grid[1] - grid[0]), joint.gravity(grid)
        here = find_widest_runs(gravity, grid, centres, 0.0, limits, rests, first, last)
        promise = np.where(here[:, 0] < 0, -np.inf, here[:, 0] * step - penalty * centres / joint.weight)
        top = int(promise.argmax())
        if promise[top] > worth and level >= _REFINED_FROM:
            stiffness = float(centres[top])
            # the allowed rest angle that shifts the torques of this run nearest to the middle of the limits
            middle = 0.5 * ((here[top, 2] - joint.torque_high) + (here[top, 1] - joint.torque_low)) / stiffness
            spring = stiffness, float(np.clip(middle, *rest))
            start = joint.widest_interval(*spring, required)
            if start is not None:
                refined = refine_spring(joint, (*start, *spring), required, rest, most_refined, penalty)
                for each, part in ((spring, start), (refined, joint.widest_interval(*refined, required))):
                    if part is not None and part[1] - part[0] - penalty * each[0] / joint.weight > worth:
                        best, worth = each, part[1] - part[0] - penalty * each[0] / joint.weight
        wide = find_widest_runs(gravity, grid, centres, half, limits, rests, first, last)
        most = np.where(wide[:, 0] < 0, -np.inf, np.minimum((wide[:, 0] + 2) * step, joint.upper - joint.lower))
        most -= penalty * np.maximum(centres - half, 0.0) / joint.weight
        open_ = most > worth + _TOLERANCE
        pruned = max(pruned, float(most[~open_].max(initial=-np.inf)))
        bound = max(worth, pruned, float(most[open_].max(initial=-np.inf)))
        if not open_.any():
            break
        half *= 0.25
        centres = (centres[open_, None] + half * np.array([-3.0, -1.0, 1.0, 3.0])).ravel()
    return best, worth, bound


_MARGIN = 1e-7  # fraction of the weight: larger than the solver's violation of its constraints


def refine_spring(  # noqa: PLR0917
    joint: OneJoint,
    start: tuple[float, float, float, float],
    required: Sequence[float],
    rest: tuple[float, float],
    stiffest: float,
    penalty: float,
) -> tuple[float, float]:
    """Return stiffness, N·m/rad, and rest angle, rad, with the widest range, by sequential quadratic programming.

    ``start`` is the held range, rad, the stiffness and the rest angle of the spring to refine. The torques at both
    ends, at the turning points between them (eq. 7.9) and at required angles (eq. 7.11) are constrained to the person's
    limits. The number of turning points stays as at the start. The result is the start if the solver fails, so the
    caller must check whether the range is wider. ``penalty`` is the penalty for a stiffness of mgl per radian, rad.
    """
    low, high, stiffness, at = start
    weight = joint.weight
    first = np.array([low, high, stiffness / weight, stiffness * at / weight])
    bounds = Bounds(
        np.array([joint.lower, joint.lower, 0.0, -np.inf]),
        np.array([joint.upper, joint.upper, stiffest / weight, np.inf]),
    )
    phase = float(np.arctan2(joint.cosine, joint.sine))
    inside = joint.turning_points(stiffness)
    inside = inside[(inside > low) & (inside < high)]
    half = np.arccos(np.clip(-stiffness / weight, -1, 1))
    sign = np.sign(np.sin(inside + phase))
    base = inside + phase - sign * half  # multiples of a full rotation
    least, most = joint.torque_low / weight + _MARGIN, joint.torque_high / weight - _MARGIN

    def margins(x: FloatArray) -> FloatArray:
        """Return the margins to all limits; x has both ends of the range, k / mgl and k θ₀ / mgl."""
        turning = base - phase + sign * np.arccos(np.clip(-x[2], -1, 1))
        angles = np.concatenate([x[:2], turning, required])
        value = np.sin(angles + phase) + x[2] * angles - x[3]
        return np.concatenate([value - least, most - value, [x[3] - x[2] * rest[0], x[2] * rest[1] - x[3]]])

    constraint: Any = {"type": "ineq", "fun": margins}
    options: Any = {"ftol": 1e-12, "maxiter": 100}

    def cost(x: FloatArray) -> float:
        return float(x[0] - x[1] + penalty * x[2])

    result = minimize(cost, first, method="SLSQP", bounds=bounds, constraints=constraint, options=options)
    if not np.isfinite(result.x).all() or result.x[2] <= 0:
        return stiffness, at
    return float(result.x[2] * weight), float(np.clip(result.x[3] / result.x[2], *rest))


_LEAST_GRID = 721
_LEAST_STEPS = 200


def find_least_spring(
    joint: OneJoint, interval: tuple[float, float], rest: tuple[float, float], stiffest: float | None = None
) -> tuple[float, float] | None:
    """Return stiffness, N·m/rad, and rest angle, rad, of the softest spring that holds an interval of angles, rad.

    The result is (0, NaN) if no spring is needed, and None if no spring is sufficient. ``rest`` contains the smallest
    and largest rest angle, rad. ``stiffest`` is the largest stiffness; by default it is twenty times the largest
    gravitational moment per radian.
    """
    grid = np.linspace(*interval, _LEAST_GRID) if interval[1] > interval[0] else np.array([interval[0]])
    gravity = joint.gravity(grid)

    def excess(k: float) -> float:
        w = gravity + k * grid
        above, below = w.max() - joint.torque_high, w.min() - joint.torque_low
        return float(max(above - below, above - k * rest[1], k * rest[0] - below)) / joint.weight

    if excess(0.0) <= 1e-9:
        return 0.0, np.nan
    # the minimum of the convex function by ternary search, or the first stiffness at which it is at most 0
    low, high = 0.0, 20.0 * joint.weight if stiffest is None else stiffest
    best: float | None = None
    for _ in range(_LEAST_STEPS):
        one, other = low + (high - low) / 3, high - (high - low) / 3
        here, there = excess(one), excess(other)
        if min(here, there) <= 0:
            best = one if here <= 0 else other
            break
        low, high = (low, other) if here <= there else (one, high)
    best = 0.5 * (low + high) if best is None else best
    if excess(best) > 1e-9:
        return None
    outside, inside = 0.0, best
    for _ in range(_LEAST_STEPS):
        middle = 0.5 * (outside + inside)
        outside, inside = (outside, middle) if excess(middle) <= 1e-9 else (middle, inside)
    # the allowed rest angle that best centres the torques in the limits
    w = gravity + inside * grid
    middle = 0.5 * (w.max() - joint.torque_high + w.min() - joint.torque_low) / inside
    return inside, float(np.clip(middle, *rest))
