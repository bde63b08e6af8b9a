"""Pressures of a cylinder for a spring, for a wide range or for tasks; its gas, and its parameters from a log.

The torque and the stiffness of a cylinder are linear in the sealed pressures. The pressures for a spring at its rest
angle are therefore the solution of two linear equations. The nearest pressures over a range are a linear least-squares
solution. Both are bounded by the lowest pressure and the supply.

The joint is held where g(θ) - τ(θ) is within the limits of the person's torque, for isothermal and for adiabatic
changes of volume: a posture is reached fast, and the gas then reaches the temperature of its surroundings. Friction is
ignored, because it helps to hold the joint. τ is linear in the sealed pressures. The pressures that hold given angles
with the largest margin are therefore the solution of a linear programme.

Areas, dead lengths, angle of full flexion, exponent and friction are fitted by least squares, with wide priors around
the described device. A parameter that the log does not determine keeps its described value and a wide interval. The
pulley's radius and the stroke are not estimated, because the torque depends only on radius times area and on lengths
over radius.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares, linprog, lsq_linear

from mocap_id.arrays import BoolArray, FloatArray, IntArray, find_runs
from mocap_id.dynamics.cylinder import ADIABATIC, ISOTHERMAL, Cylinder, PressureLimits, Setting
from mocap_id.errors import NumericalError

if TYPE_CHECKING:
    from mocap_id_assist.springs import OneJoint  # loads numba, which `mocap-id pneumatic` does not need

_STROKE_GRID = 361
_CLOSE = 0.01  # largest differences of an attained spring: fraction of the stiffness, and rad


@dataclass(frozen=True)
class NearestSpring:
    """A setting of the cylinder, and the spring that it gives."""

    setting: Setting
    stiffness: float  # N·m/rad, at the rest angle, or of the line fitted over the range; NaN without a rest angle
    rest: float  # rest angle, rad; NaN if the torque is not zero at any angle of the stroke
    largest_error: float  # largest difference from the torque of the prescribed spring over the range, N·m
    rms_error: float  # root mean square of this difference, N·m
    range: tuple[float, float]  # range of angles over which the springs are compared, rad
    why: str  # reason why the spring is not attained; empty if it is attained


def find_nearest_setting(
    cylinder: Cylinder, stiffness: float, rest: float, limits: PressureLimits, angles: FloatArray | None = None
) -> NearestSpring:
    """Return the setting nearest to a linear spring of ``stiffness`` k, N·m/rad, and ``rest`` angle θ₀, rad.

    The torques should agree over ``angles`` (N,), rad; angles beyond the stroke are ignored. By default, stiffness and
    torque should agree at the rest angle, or the torque over the whole stroke if θ₀ is beyond it.

    ValueError is raised if no angle is within the stroke.
    """
    low, high = cylinder.limits
    local = angles is None and low <= rest <= high
    grid = np.linspace(low, high, _STROKE_GRID) if angles is None else angles[(angles >= low) & (angles <= high)]
    if not len(grid):
        raise ValueError(
            f"no angle of the range is within the stroke, {np.degrees(low):.1f}° to {np.degrees(high):.1f}°"
        )
    if local:
        weight = 0.25 * (high - low)  # rad: an error of stiffness counts as the torque at this distance
        angle = np.array(rest)
        matrix = np.stack([cylinder.torque_by_pressure(angle), -weight * cylinder.stiffness_by_pressure(angle)])
        target = np.array([-cylinder.torque_of_atmosphere(), -weight * stiffness])
    else:
        matrix = cylinder.torque_by_pressure(grid)
        target = -stiffness * (grid - rest) - cylinder.torque_of_atmosphere()
    free = np.linalg.lstsq(matrix * limits.supply, target, rcond=None)[0] * limits.supply
    share = lsq_linear(matrix * limits.supply, target, (limits.lowest / limits.supply, 1.0), method="bvls").x
    setting = Setting(*(share * limits.supply).tolist())
    torque = cylinder.torque(grid, setting)
    error = torque + stiffness * (grid - rest)

    # the attained spring: at its rest angle, or of a line fitted over the range
    if local:
        zero = cylinder.rest_angle(setting)
        attained_rest = np.nan if zero is None else zero
        attained = float(cylinder.stiffness(np.array(attained_rest), setting))
    else:
        line = np.stack([grid, np.ones_like(grid)], axis=1)
        slope, offset = np.linalg.lstsq(line, torque, rcond=None)[0]
        attained, attained_rest = -float(slope), float(-offset / slope) if slope else np.nan

    # why it is not the target
    parts = []
    for name, pressure in zip(("flexion", "extension"), free.tolist(), strict=True):
        if pressure > limits.supply * (1 + 1e-9):
            parts.append(f"the {name} chamber would need {pressure:.0f} Pa, but the supply has {limits.supply:.0f} Pa")
        elif pressure < limits.lowest * (1 - 1e-9):
            parts.append(f"the {name} chamber would need {pressure:.0f} Pa, but the lowest is {limits.lowest:.0f} Pa")
    if not low <= rest <= high:
        limit = f"{np.degrees(low):.1f}° to {np.degrees(high):.1f}°"
        parts.append(f"the rest angle {np.degrees(rest):.1f}° is beyond the stroke, {limit}")
    close = abs(attained - stiffness) <= _CLOSE * stiffness and abs(attained_rest - rest) <= _CLOSE
    return NearestSpring(
        setting=setting,
        stiffness=attained,
        rest=attained_rest,
        largest_error=float(np.abs(error).max()),
        rms_error=float(np.sqrt(np.mean(error**2))),
        range=(float(grid.min()), float(grid.max())),
        why="" if close else "; ".join(parts or ["the torque of a cylinder is not linear over this range"]),
    )


RESERVE = 0.1
"""Reserve of torque in tasks, in addition to friction, as a fraction of half the range of the person's torque."""


_SEARCH, _SIDE, _LEVELS, _FINE = 361, 33, 5, 2881  # angles and pressures of the grids; levels of the search
_TASK = 41  # number of angles of each task
_SLACK = 1e-6  # tolerance of the limits, as a fraction of the largest gravitational moment


def find_held_angles(joint: OneJoint, cylinder: Cylinder, setting: Setting, angle: FloatArray) -> BoolArray:
    """Return whether each angle (N,), rad, can be held with a setting; False beyond the stroke."""
    slack = _SLACK * joint.weight
    torque = [joint.gravity(angle) - each.torque(angle, setting) for each in _slow_and_fast(cylinder)]
    return np.asarray(np.all([(t >= joint.torque_low - slack) & (t <= joint.torque_high + slack) for t in torque], 0))


def _slow_and_fast(cylinder: Cylinder) -> tuple[Cylinder, Cylinder]:
    """Return the cylinder for isothermal and for adiabatic changes of volume."""
    return cylinder.at_exponent(ISOTHERMAL), cylinder.at_exponent(ADIABATIC)


def find_held_range(
    joint: OneJoint, cylinder: Cylinder, setting: Setting, required: Sequence[float] = ()
) -> tuple[float, float] | None:
    """Return the widest interval that can be held and contains all required angles, rad; None if there is none."""
    angle = np.linspace(joint.lower, joint.upper, _FINE)
    held = find_held_angles(joint, cylinder, setting, angle)
    parts = [(float(angle[run.start]), float(angle[run.stop - 1])) for run in find_runs(held)]
    step = float(angle[1] - angle[0])
    fitting = [part for part in parts if all(part[0] - step <= one <= part[1] + step for one in required)]
    return max(fitting, key=lambda part: part[1] - part[0], default=None)


def find_widest_setting(
    joint: OneJoint, cylinder: Cylinder, limits: PressureLimits, start: Setting, required: Sequence[float] = ()
) -> Setting:
    """Return the setting with the widest interval that can be held, by a search on ever finer grids of pressures.

    The result is at least as good as ``start``, such as the setting of the nearest spring. The interval must contain
    the ``required`` angles, rad.
    """
    best, worth = start, _held_width(joint, cylinder, start, required)
    centre, half = 0.5 * (limits.lowest + limits.supply) * np.ones(2), 0.5 * (limits.supply - limits.lowest)
    angle = np.linspace(joint.lower, joint.upper, _SEARCH)
    for _ in range(_LEVELS):
        sides = [np.clip(np.linspace(c - half, c + half, _SIDE), limits.lowest, limits.supply) for c in centre]
        pressures = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
        width = _held_widths(joint, cylinder, angle, pressures, required) - 1e-3 * pressures.sum(axis=1) / limits.supply
        for top in np.argsort(-width)[:3]:
            trial = Setting(*pressures[top].tolist())
            other = _held_width(joint, cylinder, trial, required)
            if other > worth:
                best, worth = trial, other
        centre, half = best.pressures(), half / 6
    return best


def _held_width(joint: OneJoint, cylinder: Cylinder, setting: Setting, required: Sequence[float]) -> float:
    part = find_held_range(joint, cylinder, setting, required)
    return -1.0 if part is None else part[1] - part[0]


def _held_widths(
    joint: OneJoint, cylinder: Cylinder, angle: FloatArray, pressures: FloatArray, required: Sequence[float]
) -> FloatArray:
    """Return the width (M,) of the widest suitable held interval for pressures (M, 2), rad; -1 if there is none."""
    held = np.repeat(cylinder.allows(angle)[:, None], len(pressures), axis=1)  # (N, M)
    for each in _slow_and_fast(cylinder):
        torque = each.torque_by_pressure(angle) @ pressures.T + each.torque_of_atmosphere()
        needed = joint.gravity(angle)[:, None] - torque
        held &= (needed >= joint.torque_low) & (needed <= joint.torque_high)
    step = float(angle[1] - angle[0])
    first, last = (len(angle), -1) if not required else (int((min(required) - angle[0]) / step), 0)
    if required:
        last = int(np.ceil((max(required) - angle[0]) / step))
        held[:, ~held[first : last + 1].all(axis=0)] = False
    run = np.zeros(len(pressures), dtype=np.int64)
    most = run.copy()
    for k, row in enumerate(held):
        run = (run + 1) * row
        # only intervals that contain all required angles count
        counts = np.ones(len(run), dtype=bool) if not required else (k >= last) & (run > k - first)
        most = np.where(counts, np.maximum(most, run), most)
    return np.where(most > 0, (most - 1) * step, -1.0)


def find_task_setting(
    joint: OneJoint, cylinder: Cylinder, limits: PressureLimits, tasks: Sequence[tuple[float, float]]
) -> tuple[Setting, float] | None:
    """Return the lowest pressures that hold all tasks with a reserve, and the margin with these pressures, N·m.

    Tasks are intervals of angles, rad; None is returned if one of them is beyond the stroke. The reserve is
    :data:`RESERVE` plus the Coulomb friction, so that the person can also move. If no pressures have this reserve, the
    pressures with the largest margin are returned. If the margin is negative, some angle of a task cannot be held.
    """
    angle = np.concatenate([np.linspace(low, high, _TASK) for low, high in tasks])
    if not cylinder.allows(angle).all():
        return None
    by = np.concatenate([each.torque_by_pressure(angle) for each in _slow_and_fast(cylinder)]) * limits.supply
    needed = np.tile(joint.gravity(angle) - cylinder.torque_of_atmosphere(), 2)
    ones = np.ones((len(needed), 1))
    rows = np.concatenate([np.hstack([-by, ones]), np.hstack([by, ones])])  # variables: pressures / supply, margin
    most = np.concatenate([joint.torque_high - needed, needed - joint.torque_low])
    bounds = [(limits.lowest / limits.supply, 1.0)] * 2
    widest = linprog([0.0, 0.0, -1.0], rows, most, bounds=[*bounds, (None, None)])
    if widest.x is None:
        return None
    reserve = RESERVE * 0.5 * (joint.torque_high - joint.torque_low) + cylinder.coulomb
    margin = min(float(widest.x[2]), reserve)
    least = linprog([1.0, 1.0, 0.0], rows, most, bounds=[*bounds, (margin - 1e-9, None)])
    share = widest.x if least.x is None else least.x
    return Setting(*(share[:2] * limits.supply).tolist()), margin


GAS_CONSTANT = 287.05  # J/(kg K), dry air
_NORMAL_DENSITY = 1.2929  # kg/m³, air at 0 °C and 101,325 Pa


def gas_of_change(cylinder: Cylinder, before: Setting, after: Setting, temperature: float = 293.15) -> float:
    """Return the mass of gas that a change of the setting takes from the supply, kg, at a temperature, K.

    A chamber that loses pressure vents and takes no gas. An open chamber has the pressure of the atmosphere at full
    flexion. The mass of gas in a chamber is P₀V₀/RT, and does not depend on the angle at which the setting is changed.
    The hoses between valve and supply are not included.
    """
    sealed = [
        [cylinder.atmosphere if pressure is None else pressure for pressure in (setting.flexion, setting.extension)]
        for setting in (before, after)
    ]
    change = np.array(sealed[1]) - np.array(sealed[0])
    volumes = cylinder.volumes(np.asarray(cylinder.full_flexion))
    return float(np.maximum(change, 0.0) @ volumes / (GAS_CONSTANT * temperature))


def normal_litres(gas: float) -> float:
    """Return the volume of a mass of air, kg, at 0 °C and 101,325 Pa, in litres."""
    return 1e3 * gas / _NORMAL_DENSITY


# field: (prior standard deviation, whether it refers to the logarithm, lower and upper bound of the field)
_PRIORS: Mapping[str, tuple[float, bool, float, float]] = {
    "area_flexion": (0.5, True, 0.0, np.inf),
    "area_extension": (0.5, True, 0.0, np.inf),
    "dead_flexion": (1.0, True, 0.0, np.inf),
    "dead_extension": (1.0, True, 0.0, np.inf),
    "full_flexion": (np.radians(10.0), False, -2 * np.pi, 2 * np.pi),
    "exponent": (0.2, False, ISOTHERMAL, ADIABATIC),
    "coulomb": (1.0, False, 0.0, np.inf),
    "viscous": (0.5, False, 0.0, np.inf),
}


ESTIMATED = tuple(_PRIORS)
"""Fields of :class:`Cylinder` that are estimated."""


_DETERMINED = 0.3  # largest ratio of posterior to prior standard deviation of a parameter that the log determines
_LEAST_DEAD = 1e-4  # m: a described dead length of zero cannot be scaled
_ROUNDS = 100  # largest number of evaluations of the fit
_MISFIT = 0.3  # largest residual of a log that fits a cylinder, as a fraction of the torque
_NORMAL_95 = 1.959964  # half-width of a 95 % interval, standard deviations


@dataclass(frozen=True)
class TorqueLog:
    """A log of torque against angle, with N samples."""

    angle: FloatArray  # (N,) angle of the joint, rad
    torque: FloatArray  # (N,) torque of the device on the joint, N·m
    velocity: FloatArray | None  # (N,) rad/s; without velocities, friction is not estimated
    settings: tuple[Setting, ...]
    which: IntArray  # (N,) index of the setting of each sample
    # (N, m) errors of the torque that are constant during the log, N·m: the error is the sum of the columns, each times
    # an unknown factor of standard deviation 1
    lasting: FloatArray | None = None


def identify_cylinder(
    described: Cylinder, log: TorqueLog
) -> tuple[Cylinder, dict[str, tuple[float, float]], dict[str, bool], float]:
    """Return the cylinder that fits a log best, near the described cylinder, with intervals and residual.

    The 95 % interval of each parameter follows, then whether the log determines it (if not, the described value
    dominates), and the root mean square of the residual torque, N·m.

    NumericalError is raised if the log does not fit any cylinder near the described one.
    """
    names = [name for name in ESTIMATED if log.velocity is not None or name not in ("coulomb", "viscous")]
    described = replace(
        described,
        dead_flexion=max(described.dead_flexion, _LEAST_DEAD),
        dead_extension=max(described.dead_extension, _LEAST_DEAD),
    )
    count, lasting = len(names), np.zeros((len(log.angle), 0)) if log.lasting is None else log.lasting
    factors = lasting.shape[1]

    def encode(name: str, value: float) -> float:
        """Return the value of a parameter, or its logarithm if the prior refers to the logarithm."""
        if not _PRIORS[name][1]:
            return value
        return float(np.log(value)) if value > 0 else -np.inf

    # means, standard deviations and bounds of the encoded parameters, and of the factors of lasting errors
    prior = np.array([encode(name, getattr(described, name)) for name in names] + [0.0] * factors)
    scale = np.array([_PRIORS[name][0] for name in names] + [1.0] * factors)
    bounds = np.array(
        [
            [encode(name, _PRIORS[name][2]) for name in names] + [-np.inf] * factors,
            [encode(name, _PRIORS[name][3]) for name in names] + [np.inf] * factors,
        ]
    )

    def cylinder(code: FloatArray) -> Cylinder:
        fields = {
            name: float(np.exp(c)) if _PRIORS[name][1] else float(c)
            for name, c in zip(names, code[:count], strict=True)
        }
        return replace(described, **fields)

    def residual(code: FloatArray) -> FloatArray:
        return np.nan_to_num(predict_torque(cylinder(code), log), nan=1e3) - log.torque + lasting @ code[count:]

    def scaled(code: FloatArray, sigma: float) -> FloatArray:
        return np.concatenate([residual(code) / sigma, (code - prior) / scale])

    code, sigma = np.clip(prior, bounds[0] + 1e-6, bounds[1] - 1e-6), 0.05 * float(np.std(log.torque)) + 1e-6
    for _ in range(3):
        fit = least_squares(scaled, code, bounds=(bounds[0], bounds[1]), x_scale=scale, args=(sigma,), max_nfev=_ROUNDS)
        code = fit.x
        # the standard deviation of the residuals, increased for their correlation from sample to sample
        left = residual(code)
        square = float(left @ left)
        correlation = float(np.clip(float(left[:-1] @ left[1:]) / max(square, 1e-30), 0.0, 0.99))
        variance = square / max(len(left) - len(code), 1)
        sigma = float(np.sqrt(variance * (1 + correlation) / (1 - correlation))) + 1e-9
    rms = float(np.sqrt(np.mean(residual(code) ** 2)))
    if not fit.success or rms > _MISFIT * float(np.sqrt(np.mean(log.torque**2))):
        raise NumericalError(
            f"the log does not fit a cylinder near the described one (residual {rms:.2f} N·m): check signs, units and "
            "pressures of the log, the angle of full flexion, and whether the person of a trial was relaxed"
        )
    jacobian = np.asarray(fit.jac, dtype=np.float64)
    sd = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    ends = np.clip(code + np.array([[-_NORMAL_95], [_NORMAL_95]]) * sd, *bounds)[:, :count]
    values = np.where([_PRIORS[name][1] for name in names], np.exp(ends), ends)
    interval = {name: (float(low), float(high)) for name, low, high in zip(names, *values, strict=True)}
    determined = {name: bool(sd[k] < _DETERMINED * scale[k]) for k, name in enumerate(names)}
    return cylinder(code), interval, determined, rms


def predict_torque(cylinder: Cylinder, log: TorqueLog) -> FloatArray:
    """Return the torque of the device, with friction if the log has velocities, for each sample, N·m."""
    torque = np.zeros(len(log.angle))
    for k, setting in enumerate(log.settings):
        rows = log.which == k
        by_pressure = cylinder.torque_by_pressure(log.angle[rows], setting.sealed)
        torque[rows] = by_pressure @ setting.pressures() + cylinder.torque_of_atmosphere(setting.sealed)
    return torque if log.velocity is None else torque + cylinder.friction(log.velocity)
