"""Global search for the spring with which a person can hold the largest range of a joint (eq. 7.10, 7.11).

With w(θ) = g(θ) + kθ, an angle can be held if w - kθ₀ is within the limits of the torque. An interval can be held with
some rest angle if w varies in it by at most the distance of the limits, and if an allowed rest angle shifts it between
them. For one stiffness, a single pass over a grid of angles finds the widest such interval
(:mod:`mocap_id.prescription.torque_windows`) for all rest angles. The stiffness is searched by branch and bound: if it
changes by up to h, the torques change by at most h times a known angle, so limits widened by this bound the result of
all these stiffnesses. Sequential quadratic programming refines the best spring with its turning points (eq. 7.9). The
reported range can be held exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.prescription.one_joint import OneJoint
from mocap_id.prescription.refinement import refine_spring
from mocap_id.prescription.torque_windows import widest_by_stiffness

REST = (-2 * np.pi, 2 * np.pi)
"""Allowed rest angles, rad (eq. 7.10)."""
PENALTY = 1e-4
"""δ of eq. 7.10: gain of range that justifies a stiffness of mgl per radian, rad."""
_HELPS = np.radians(0.5)  # a smaller gain of range is no help
_TOLERANCE = np.radians(0.2)
_COARSE, _FINE, _LEVELS, _POLISHED_FROM = 512, 4096, 16, 3


@dataclass(frozen=True)
class SpringRequirements:
    """Requirements for a spring.

    Parameters
    ----------
    required : tuple of float
        Angles that must be within the range, rad (eq. 7.11).
    rest : (low, high)
        Allowed rest angles, rad.
    stiffest : float, optional
        Largest stiffness, N·m/rad; 0 for no spring. By default all stiffnesses that could help are allowed.
    penalty : float
        δ, the penalty per stiffness over mgl, rad.
    """

    required: tuple[float, ...] = ()
    rest: tuple[float, float] = REST
    stiffest: float | None = None
    penalty: float = PENALTY


@dataclass(frozen=True)
class Prescription:
    """A spring prescribed for one joint.

    Parameters
    ----------
    stiffness : float
        N·m/rad; 0 for no spring.
    rest : float
        θ₀, rad; NaN for no spring.
    range : (low, high)
        Range that can be held with the spring, rad.
    without : (low, high) or None
        The widest range that can be held without it, rad.
    gap : float
        Upper bound of the gain in range minus penalty by any other spring, rad.
    helps : bool
        Whether the spring gives a relevant gain.
    """

    stiffness: float
    rest: float
    range: tuple[float, float]
    without: tuple[float, float] | None
    gap: float
    helps: bool


@dataclass(frozen=True)
class _Spring:
    """Stiffness, N·m/rad, rest angle and width of the range, rad."""

    stiffness: float
    rest: float
    width: float


def prescribe_spring(joint: OneJoint, wishes: SpringRequirements = SpringRequirements()) -> Prescription:
    """Find the best spring for one joint.

    Raises
    ------
    ValueError
        A required angle is outside the joint's limits, or no spring lets the person hold all of them.
    """
    for angle in wishes.required:
        if not joint.lower <= angle <= joint.upper:
            raise ValueError(
                f"the required angle {np.degrees(angle):.1f}° is outside the joint's limits, "
                f"{np.degrees(joint.lower):.1f}° to {np.degrees(joint.upper):.1f}°"
            )
    without = _containing(joint, 0.0, 0.0, wishes.required)
    none = -np.inf if without is None else without[1] - without[0]
    best, bound = _search(joint, wishes, none) if wishes.stiffest != 0 else (None, none)
    free = joint.widest(0.0, 0.0)
    if without is not None and (best is None or _worth(joint, wishes, best) <= none + _HELPS):
        return Prescription(0.0, np.nan, without, free, max(bound - none, 0.0), False)
    if best is None:
        raise ValueError("no spring lets the person hold all required angles and the angles between them")
    found = _containing(joint, best.stiffness, best.rest, wishes.required)
    assert found is not None
    return Prescription(best.stiffness, best.rest, found, free, max(bound - _worth(joint, wishes, best), 0.0), True)


def _containing(
    joint: OneJoint, stiffness: float, rest: float, required: tuple[float, ...]
) -> tuple[float, float] | None:
    """Return the widest interval that can be held and contains every required angle."""
    tolerance = 1e-6
    fitting = [
        part
        for part in joint.held(stiffness, rest)
        if all(part[0] - tolerance <= angle <= part[1] + tolerance for angle in required)
    ]
    return max(fitting, key=lambda part: part[1] - part[0], default=None)


def _search(joint: OneJoint, wishes: SpringRequirements, none: float) -> tuple[_Spring | None, float]:
    """Return the best spring, and an upper bound of range minus penalty, rad; ``none`` is the range without spring."""
    half = 0.5 * _stiffest(joint, wishes, none)
    centres, best, worth, bound = np.array([half]), None, none, np.inf
    limits, rests = np.array([joint.torque_low, joint.torque_high]), np.array(wishes.rest)
    pruned = none
    for level in range(_LEVELS):
        grid, first, last = _grid(joint, wishes, min(_FINE, _COARSE << level // 2))
        step, gravity = float(grid[1] - grid[0]), joint.gravity(grid)
        here = widest_by_stiffness(gravity, grid, centres, 0.0, limits, rests, first, last)
        promise = np.where(here[:, 0] < 0, -np.inf, here[:, 0] * step - wishes.penalty * centres / joint.weight)
        top = int(promise.argmax())
        if promise[top] > worth and level >= _POLISHED_FROM:
            stiffness = float(centres[top])
            found = _polished(joint, wishes, stiffness, _rest(joint, wishes, stiffness, here[top, 1], here[top, 2]))
            if found is not None and _worth(joint, wishes, found) > worth:
                best, worth = found, _worth(joint, wishes, found)
        wide = widest_by_stiffness(gravity, grid, centres, half, limits, rests, first, last)
        most = np.where(wide[:, 0] < 0, -np.inf, np.minimum((wide[:, 0] + 2) * step, joint.upper - joint.lower))
        most -= wishes.penalty * np.maximum(centres - half, 0.0) / joint.weight
        open_ = most > worth + _TOLERANCE
        pruned = max(pruned, float(most[~open_].max(initial=-np.inf)))
        bound = max(worth, pruned, float(most[open_].max(initial=-np.inf)))
        if not open_.any():
            break
        half *= 0.25
        centres = (centres[open_, None] + half * np.array([-3.0, -1.0, 1.0, 3.0])).ravel()
    return best, bound


def _stiffest(joint: OneJoint, wishes: SpringRequirements, none: float) -> float:
    """Return a stiffness above which no range is wider than without a spring, or than five degrees.

    Over a range R, a spring changes the torque by kR, and gravity compensates 2mgl of this at most.
    """
    if wishes.stiffest is not None:
        return wishes.stiffest
    least = max(none, np.ptp(wishes.required) if wishes.required else 0.0, np.radians(5.0))
    return float((joint.torque_high - joint.torque_low + 2 * joint.weight) / least)


def _grid(joint: OneJoint, wishes: SpringRequirements, size: int) -> tuple[FloatArray, int, int]:
    """Return the angles (M,), and the indices of the first and last of the required ones."""
    grid = np.linspace(joint.lower, joint.upper, size)
    if not wishes.required:
        return grid, 1, 0
    inner = np.flatnonzero((grid >= min(wishes.required)) & (grid <= max(wishes.required)))
    nearest = int(np.abs(grid - wishes.required[0]).argmin())
    return (grid, int(inner[0]), int(inner[-1])) if len(inner) else (grid, nearest, nearest)


def _rest(joint: OneJoint, wishes: SpringRequirements, stiffness: float, low: float, high: float) -> float:
    """Return the rest angle that shifts torques low and high to the middle of the limits, as far as allowed."""
    middle = 0.5 * ((high - joint.torque_high) + (low - joint.torque_low)) / stiffness
    return float(np.clip(middle, *wishes.rest))


def _polished(joint: OneJoint, wishes: SpringRequirements, stiffness: float, rest: float) -> _Spring | None:
    """Return the better of a spring and its refinement; None if the spring holds nothing."""
    start = _containing(joint, stiffness, rest, wishes.required)
    if start is None:
        return None
    most = np.inf if wishes.stiffest is None else wishes.stiffest
    other = refine_spring(joint, (*start, stiffness, rest), wishes.required, wishes.rest, most, wishes.penalty)
    part = _containing(joint, *other, wishes.required)
    springs = [_Spring(stiffness, rest, start[1] - start[0])]
    if part is not None:
        springs.append(_Spring(*other, part[1] - part[0]))
    return max(springs, key=lambda spring: _worth(joint, wishes, spring))


def _worth(joint: OneJoint, wishes: SpringRequirements, spring: _Spring) -> float:
    """Return the objective of the search: range minus penalty, rad."""
    return spring.width - wishes.penalty * spring.stiffness / joint.weight
