"""Parameters of a cylinder from a log of torque against angle.

Areas, dead lengths, angle of full flexion, exponent and friction are fitted by least squares, with wide priors around
the described device. A parameter that the log does not determine keeps its described value and a wide interval. The
pulley's radius and the stroke are not estimated, because the torque depends only on radius times area and on lengths
over radius.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.errors import NumericalError
from mocap_id.pneumatics.cylinder import ADIABATIC, ISOTHERMAL, Cylinder, Setting

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


@dataclass(frozen=True)
class IdentifiedCylinder:
    """A cylinder identified from a log."""

    cylinder: Cylinder  # the cylinder with the estimated parameters
    interval: Mapping[str, tuple[float, float]]  # 95 % interval of each parameter
    determined: Mapping[str, bool]  # whether the log determines the parameter; if not, the described value dominates
    residual: float  # root mean square of the residual torque, N·m


def identify_cylinder(described: Cylinder, log: TorqueLog) -> IdentifiedCylinder:
    """Return the cylinder that fits a log best, near the described cylinder.

    NumericalError is raised if the log does not fit any cylinder near the described one.
    """
    names = [name for name in ESTIMATED if log.velocity is not None or name not in ("coulomb", "viscous")]
    described = replace(
        described,
        dead_flexion=max(described.dead_flexion, _LEAST_DEAD),
        dead_extension=max(described.dead_extension, _LEAST_DEAD),
    )
    count, lasting = len(names), np.zeros((len(log.angle), 0)) if log.lasting is None else log.lasting
    prior, scale, bounds = _priors(described, names, lasting.shape[1])

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
        code, sigma = fit.x, _residual_sd(residual(fit.x), len(code))
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
    return IdentifiedCylinder(cylinder(code), interval, determined, rms)


def _priors(described: Cylinder, names: Sequence[str], factors: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return means (k,), standard deviations (k,) and bounds (2, k) of encoded parameters and of factors of errors."""
    mean = np.array([_encode(name, getattr(described, name)) for name in names])
    scale = np.array([_PRIORS[name][0] for name in names])
    bounds = np.array([[_encode(name, _PRIORS[name][k]) for name in names] for k in (2, 3)])
    free = np.full((2, factors), [[-np.inf], [np.inf]])
    return np.append(mean, np.zeros(factors)), np.append(scale, np.ones(factors)), np.hstack([bounds, free])


def predict_torque(cylinder: Cylinder, log: TorqueLog) -> FloatArray:
    """Return the torque of the device, with friction if the log has velocities, for each sample, N·m."""
    torque = np.zeros(len(log.angle))
    for k, setting in enumerate(log.settings):
        rows = log.which == k
        by_pressure = cylinder.torque_by_pressure(log.angle[rows], setting.sealed)
        torque[rows] = by_pressure @ setting.pressures() + cylinder.torque_of_atmosphere(setting.sealed)
    return torque if log.velocity is None else torque + cylinder.friction(log.velocity)


def _encode(name: str, value: float) -> float:
    """Return the value of a parameter, or its logarithm if the prior refers to the logarithm."""
    if not _PRIORS[name][1]:
        return value
    return float(np.log(value)) if value > 0 else -np.inf


def _residual_sd(residual: FloatArray, parameters: int) -> float:
    """Return the standard deviation of the residuals, increased for their correlation from sample to sample."""
    variance = float(residual @ residual) / max(len(residual) - parameters, 1)
    correlation = float(residual[:-1] @ residual[1:]) / max(float(residual @ residual), 1e-30)
    correlation = float(np.clip(correlation, 0.0, 0.99))
    return float(np.sqrt(variance * (1 + correlation) / (1 - correlation))) + 1e-9
