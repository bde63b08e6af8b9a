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

import heapq
import itertools
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor
from typing import Any

import numpy as np
from scipy.optimize import Bounds, minimize

from mocap_id.arrays import GRAVITY, BoolArray, FloatArray, IntArray, sobol
from mocap_id.geometry.planar import rotate, segment_poses
from mocap_id_assist.holding_kernels import count_cells, find_widest_runs
from mocap_id_assist.workspace import JointLimits, PlanarArm

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


@dataclass(frozen=True)
class ChainMasses:
    """Masses of a planar chain; ValueError is raised if a mass is not finite, or if all masses are zero."""

    centres: FloatArray  # (n, 2) centre of each joint in the frame of the previous segment, m
    # (n, 3) m, mx, my of each moving segment in its own frame, kg and kg·m. Identified parameters are sufficient:
    # only the combinations that they determine affect the torques.
    masses: FloatArray
    gravity: float = GRAVITY  # m/s², along -y

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


_CELLS = 8  # average number of postures per cell, so that few cells contain no posture
_REACHED = 1e-4  # m: largest distance of the tip from a reached point


@dataclass(frozen=True)
class SpringPlace:
    """A possible linear spring, which pulls the sum of its joints' angles towards its rest angle."""

    joints: tuple[int, ...]  # one joint, or two joints that the spring spans, counted from 0
    stiffest: float  # largest stiffness, N·m/rad
    rest: tuple[float, float] = (-2 * np.pi, 2 * np.pi)  # smallest and largest rest angle of the sum, rad


@dataclass(frozen=True)
class Postures:
    """N sampled postures that represent a functional workspace."""

    gravity: FloatArray  # (N, n) torque that holds each joint without a spring, N·m
    stretch: FloatArray  # (N, S) sum of the angles of each spring's joints, rad
    cell: IntArray  # (N,) cell of the plane that contains the tip; each required point has its own cell
    cells: int  # number C of cells of the workspace
    required: int  # number R of required points; their cells are C … C + R - 1
    size: float  # area of a cell, m²
    q: FloatArray  # (N, n) rad
    tips: FloatArray  # (N, 2) m


def sample_postures(  # noqa: PLR0917
    arm: PlanarArm,
    weights: ChainMasses,
    limits: JointLimits,
    places: Sequence[SpringPlace],
    required: FloatArray,
    count: int = 4096,
    seed: int = 0,
) -> Postures:
    """Sample postures evenly within the joint limits, and find further postures that reach each required point.

    ``required`` (R, 2) are points in the plane frame at which the tip must be held, m. ``count`` and ``seed`` determine
    the samples.

    ValueError is raised if a required point cannot be reached.
    """
    q = limits.lower + sobol(count, limits.dimension, seed) * (limits.upper - limits.lower)
    tips = arm.tips(q)
    low, high = tips.min(axis=0), tips.max(axis=0)
    side = float(np.sqrt(np.prod(high - low) / (count / _CELLS)))
    index = np.floor((tips - low) / side).astype(np.int64)
    _, cell = np.unique(index @ np.array([1 << 20, 1]), return_inverse=True)
    cells = int(cell.max()) + 1
    parts, owners = [q], [cell.astype(np.int64)]
    for k, point in enumerate(required):
        postures = _find_postures(arm, limits, point, q[np.argsort(np.linalg.norm(tips - point, axis=1))[:48]])
        if not len(postures):
            raise ValueError(f"the required point ({point[0]:g}, {point[1]:g}) m cannot be reached")
        parts.append(postures)
        owners.append(np.full(len(postures), cells + k, dtype=np.int64))
    q = np.concatenate(parts)
    stretch = np.zeros((len(q), len(places)))
    for s, place in enumerate(places):
        stretch[:, s] = q[:, list(place.joints)].sum(axis=1)
    return Postures(weights.torques(q), stretch, np.concatenate(owners), cells, len(required), side**2, q, arm.tips(q))


def _find_postures(arm: PlanarArm, limits: JointLimits, point: FloatArray, starts: FloatArray) -> FloatArray:
    """Return postures (K, n) within the limits that reach the point, by Gauss–Newton steps from each start."""
    q = starts.copy()
    step, n = 1e-6, limits.dimension
    for _ in range(40):
        off = point - arm.tips(q)
        columns = [
            (arm.tips(q + step * np.eye(n)[j]) - arm.tips(q - step * np.eye(n)[j])) / (2 * step) for j in range(n)
        ]
        jacobian = np.stack(columns, axis=-1)  # (K, 2, n)
        normal = jacobian @ np.swapaxes(jacobian, -1, -2) + 1e-10 * np.eye(2)
        move = np.swapaxes(jacobian, -1, -2) @ np.linalg.solve(normal, off[..., None])
        q = np.clip(q + move[..., 0], limits.lower, limits.upper)
    reached = q[np.linalg.norm(arm.tips(q) - point, axis=1) < _REACHED]
    distinct = np.unique(np.round(reached, 6), axis=0, return_index=True)[1]
    return np.asarray(reached[np.sort(distinct)])


BOXES = 20_000
"""Number of boxes after which the search ends."""


_CHAIN_TOLERANCE = 0.005  # fraction of the cells
_CHAIN_HELPS = 0.01  # least gain for which springs are prescribed, as a fraction of the cells
_CHAIN_SLACK = 1e-3  # fraction of the largest allowed stiffness: a softer spring counts as no spring


@dataclass(frozen=True)
class Springs:
    """The best of the S possible springs that the search found; a box is a range of stiffnesses and rest angles."""

    stiffness: FloatArray  # (S,) N·m/rad
    rest: FloatArray  # (S,) rad; NaN for an unused spring
    area: float  # area of the functional workspace with the springs, m²
    without: float  # area without springs, m²
    reachable: float  # area that the joint limits allow, m²
    gap: float  # upper bound of the further gain in area by any other springs, m²
    boxes: int  # number of evaluated boxes
    helps: bool  # whether the springs give a relevant gain


class _Search:
    """Numbers of cells and their bounds for springs (S, 2), given by stiffness and rest angle."""

    def __init__(self, postures: Postures, places: Sequence[SpringPlace], torque: FloatArray, penalty: float) -> None:
        joints = postures.gravity.shape[1]
        self.postures, self.torque, self.penalty = postures, torque, penalty
        across = [[j in place.joints for j in range(joints)] for place in places]
        self.across: BoolArray = np.array(across, dtype=np.bool_).reshape(-1, joints)
        self.low = np.array([[0.0, place.rest[0]] for place in places]).reshape(-1, 2)
        self.high = np.array([[place.stiffest, place.rest[1]] for place in places]).reshape(-1, 2)
        self.boxes = 0

    def count_cells(self, low: FloatArray, high: FloatArray) -> int:
        """Return an upper bound of the cells for the springs of a box; -1 if a required point cannot be held."""
        p = self.postures
        return count_cells(p.gravity, p.stretch, p.cell, p.cells, p.required, self.across, self.torque, low, high)

    def penalise(self, springs: FloatArray) -> float:
        """Return the penalty for the stiffnesses of springs (S, 2), as a number of cells."""
        return float(self.penalty * self.postures.cells * np.sum(springs[:, 0] / self.high[:, 0]))

    def objective(self, springs: FloatArray) -> float:
        """Return the number of held cells minus the penalty of the springs; -inf if a required point is not held."""
        count = self.count_cells(springs, springs)
        return -np.inf if count < 0 else count - self.penalise(springs)

    def bound_objective(self, low: FloatArray, high: FloatArray) -> float:
        """Return an upper bound of the objective of all springs in a box."""
        self.boxes += 1
        count = self.count_cells(low, high)
        return -np.inf if count < 0 else count - self.penalise(low)

    def split(self, low: FloatArray, high: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Return the two halves of a box; the stiffness or rest angle with the largest effect on torques is divided."""
        width = high - low
        far = np.maximum(
            np.abs(self.postures.stretch.max(axis=0) - low[:, 1]),
            np.abs(self.postures.stretch.min(axis=0) - high[:, 1]),
        )
        effect = np.stack([width[:, 0] * far, width[:, 1] * high[:, 0]], axis=1)
        side = np.unravel_index(int(effect.argmax()), effect.shape)
        middle = 0.5 * (low[side] + high[side])
        below, above = high.copy(), low.copy()
        below[side], above[side] = middle, middle
        return [(low, below), (above, high)]

    def improve(self, springs: FloatArray) -> FloatArray:
        """Return springs improved by a pattern search in stiffness and rest angle; steps are halved if none helps."""
        best, worth = springs.copy(), self.objective(springs)
        step = 0.1 * (self.high - self.low)
        for _ in range(12):
            before = worth
            for side in np.ndindex(best.shape):
                for sign in (1.0, -1.0):
                    trial = best.copy()
                    trial[side] = np.clip(trial[side] + sign * step[side], self.low[side], self.high[side])
                    other = self.objective(trial)
                    if other > worth:
                        best, worth = trial, other
            if worth == before:
                step = 0.5 * step
        return best


def prescribe_several(
    postures: Postures,
    places: Sequence[SpringPlace],
    torque: FloatArray,
    penalty: float = PENALTY,
    boxes: int = BOXES,
) -> Springs:
    """Return the springs with which a person can hold the largest functional workspace of several joints.

    ``places`` are the possible springs; if there are none, the result describes the workspace without assistance.
    ``torque`` (n, 2) are the person's limits, N·m. ``penalty`` is the fraction of the cells that justifies the largest
    allowed stiffness. The search ends after a number of boxes.

    ValueError is raised if the search found no springs that hold every required point.
    """
    search = _Search(postures, places, torque, penalty)
    nothing = np.stack([np.zeros(len(places)), 0.5 * (search.low + search.high)[:, 1]], axis=1)
    none = search.objective(nothing)
    best, worth, bound = _branch_and_bound(search, nothing, none, boxes) if places else (nothing, none, none)
    if worth == -np.inf:
        if bound > -np.inf:
            raise ValueError("the search found no springs that hold every required point")
        raise ValueError("no springs can hold every required point")
    size, cells = postures.size, postures.cells
    helps = worth > max(none, 0.0) + _CHAIN_HELPS * cells or none == -np.inf
    chosen = nothing
    if helps:  # without very soft springs, unless this reduces the number of cells
        fewer = best.copy()
        fewer[best[:, 0] <= _CHAIN_SLACK * search.high[:, 0], 0] = 0.0
        chosen = fewer if search.count_cells(fewer, fewer) >= search.count_cells(best, best) else best
    stiffness = chosen[:, 0]
    # the cells held without springs, even if required points are not held: their cells count as others
    p = postures
    free = count_cells(
        p.gravity, p.stretch, p.cell, cells + p.required, 0, search.across, search.torque, nothing, nothing
    )
    return Springs(
        stiffness=stiffness,
        rest=np.where(stiffness > 0, chosen[:, 1], np.nan),
        area=size * search.count_cells(chosen, chosen),
        without=size * free,
        reachable=size * cells,
        gap=size * max(bound - (worth if helps else none), 0.0),
        boxes=search.boxes,
        helps=bool(helps),
    )


def _branch_and_bound(search: _Search, start: FloatArray, worth: float, boxes: int) -> tuple[FloatArray, float, float]:
    """Return the best springs, their objective, and an upper bound of the objective of all springs."""
    best, ticket = start, 0
    queue = [(-search.bound_objective(search.low, search.high), ticket, search.low, search.high)]
    slack = _CHAIN_TOLERANCE * search.postures.cells
    while queue and search.boxes < boxes:
        if -queue[0][0] <= worth + slack:
            break
        _, _, low, high = heapq.heappop(queue)
        for one, other in search.split(low, high):
            promise = search.bound_objective(one, other)
            middle = 0.5 * (one + other)
            here = search.objective(middle)
            if here > worth:
                best = search.improve(middle)
                worth = search.objective(best)
            if promise > worth + slack:
                ticket += 1
                heapq.heappush(queue, (-promise, ticket, one, other))
    best = search.improve(best) if worth > -np.inf else best
    worth = search.objective(best) if worth > -np.inf else worth
    bound = max(worth + (slack if search.boxes > 1 else 0.0), -queue[0][0] if queue else -np.inf)
    return best, worth, bound


def find_held_postures(
    postures: Postures, places: Sequence[SpringPlace], torque: FloatArray, springs: Springs
) -> BoolArray:
    """Return whether each posture (N,) can be held with the springs."""
    needed = postures.gravity.copy()
    for s, place in enumerate(places):
        if springs.stiffness[s] > 0:
            pull = springs.stiffness[s] * (postures.stretch[:, s] - springs.rest[s])
            needed[:, list(place.joints)] += pull[:, None]
    return np.asarray(np.all((needed >= torque[:, 0]) & (needed <= torque[:, 1]), axis=1))


@dataclass(frozen=True)
class SubWorkspace:
    """A sub-workspace: the postures that can be held with one setting of the springs."""

    name: str
    tasks: tuple[str, ...]
    stiffness: FloatArray | None  # (S,) stiffness of the least assistance, N·m/rad; None if no spring is sufficient
    rest: FloatArray | None  # (S,) rest angles, rad; NaN for no spring
    held: BoolArray  # (N,) whether each sampled posture can be held


@dataclass(frozen=True)
class Graph:
    """Graph of sub-workspaces. Its edges are their overlaps, in which the setting can be changed."""

    nodes: tuple[SubWorkspace, ...]
    # both nodes, fraction of the sampled postures that are in both, and index of the posture in the middle of these
    switches: tuple[tuple[tuple[int, int], float, int], ...]
    postures: FloatArray  # (N, n) sampled postures, rad

    def find_path(self, start: int, end: int) -> tuple[int, ...] | None:
        """Return the nodes of the shortest path between two nodes, both included; None if there is none."""
        previous: dict[int, int] = {start: start}
        queue = deque([start])
        while queue:
            here = queue.popleft()
            if here == end:
                path = [end]
                while path[-1] != start:
                    path.append(previous[path[-1]])
                return tuple(reversed(path))
            for between, _, _ in self.switches:
                if here in between:
                    other = between[1] if between[0] == here else between[0]
                    if other not in previous:
                        previous[other] = here
                        queue.append(other)
        return None


def build_graph(nodes: Sequence[SubWorkspace], postures: FloatArray) -> Graph:
    """Return the graph of sub-workspaces, whose switches are overlaps of the sampled postures (N, n), rad."""
    switches = []
    for a in range(len(nodes)):
        for b in range(a + 1, len(nodes)):
            if nodes[a].stiffness is None or nodes[b].stiffness is None:
                continue
            both = np.flatnonzero(nodes[a].held & nodes[b].held)
            if len(both):
                middle = np.median(postures[both], axis=0)
                nearest = both[np.abs(postures[both] - middle).sum(axis=1).argmin()]
                switches.append(((a, b), len(both) / len(postures), int(nearest)))
    return Graph(tuple(nodes), tuple(switches), postures)
